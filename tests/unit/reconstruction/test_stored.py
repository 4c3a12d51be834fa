"""Holds what a scene stores to its bytes: also of places far away, of one, of none, and of no numbers."""

import pytest
import torch

from reconstruction.gaussians.stored import HALF_MAX, STEPS, restored, stored


def bytes_of(kept):
    tensors = kept.values() if isinstance(kept, dict) else [kept]
    return sum(tensor.numel() * tensor.element_size() for tensor in tensors)


def bytes_in(kept):
    assert isinstance(kept, dict)
    return kept["bytes"]


def test_places_take_two_bytes_a_number_and_are_off_by_half_a_step():
    places = torch.randn(1000, 3, generator=torch.Generator().manual_seed(0)) + torch.tensor([0.0, -3.0, 2.0])
    kept = stored("moving.means", places)
    assert bytes_of(kept) == 1000 * 3 * 2 + 2 * 3 * 4
    step = (places.amax(dim=0) - places.amin(dim=0)) / 65_535
    assert ((restored(kept) - places).abs() <= 0.51 * step + 1e-6).all()
    assert step.max() < STEPS["means"].longest
    again = restored(stored("moving.means", restored(kept)))
    assert ((again - places).abs() <= 0.6 * step + 1e-6).all()


@pytest.mark.parametrize(
    "places",
    [
        torch.zeros(0, 3),
        torch.tensor([[1.0, -2.0, 3.0]]),
        torch.ones(5, 3),
        torch.tensor([[0.0, 0.0, 0.0], [1e6, 0.0, 0.0]]),
        torch.tensor([[1e-30, 0.0, 1e6], [2e-30, 0.0, 1e6]]),
    ],
)
def test_few_places_equal_ones_and_a_sky_are_exact(places):
    found = restored(stored("means", places))
    assert found.shape == places.shape
    assert torch.allclose(found, places, rtol=1e-7, atol=1e-29)


def test_places_that_are_no_numbers_stay_as_they_are():
    for odd in (float("nan"), float("inf")):
        places = torch.tensor([[0.0, odd, 1.0], [2.0, 0.0, 1.0]])
        assert stored("means", places) is places


EIGHT_BITS = {"drifts": 0.01, "log_scales": 1.5, "log_durations": 1.0, "opacity_logits": 3.0}


@pytest.mark.parametrize(("name", "spread"), EIGHT_BITS.items())
@pytest.mark.parametrize("count", [1, 2, 1000, 1001])
def test_what_a_picture_shows_coarsely_takes_a_byte_and_is_the_same_when_it_is_stored_again(name, spread, count):
    values = spread * torch.randn(count, 3, generator=torch.Generator().manual_seed(1))
    kept = stored(f"moving.{name}", values)
    assert bytes_of(kept) == count * 3 + 2 * 3 * 4
    found = restored(kept)
    step = (values.amax(dim=0) - values.amin(dim=0)) / 255
    assert ((found - values).abs() <= 0.51 * step + 1e-6).all()
    assert torch.equal(bytes_in(stored(name, found)), bytes_in(kept))


def test_one_number_that_is_far_off_costs_the_others_no_precision():
    logits = torch.linspace(-3, 3, 100)
    logits[7] = 500.0
    assert restored(stored("opacity_logits", logits)).tolist() == pytest.approx(logits.tolist(), rel=1e-3, abs=1e-3)


def test_quaternions_of_any_length_keep_their_direction_in_four_bytes():
    quats = torch.randn(1000, 4, generator=torch.Generator().manual_seed(2))
    quats = quats * torch.logspace(-6, 6, 1000)[:, None]
    kept = stored("quats_wxyz", quats)
    assert bytes_of(kept) == 1000 * 4 + 2 * 4 * 4
    found, unit = restored(kept), torch.nn.functional.normalize(quats, dim=1)
    assert ((found - unit).norm(dim=1) <= 0.5 * 4**0.5 * STEPS["quats_wxyz"].longest).all()
    assert torch.equal(bytes_in(stored("quats_wxyz", found)), bytes_in(kept))


def test_a_quaternion_of_no_length_is_finite():
    assert torch.isfinite(restored(stored("quats_wxyz", torch.zeros(3, 4)))).all()


@pytest.mark.parametrize(
    ("largest", "kind"),
    [
        (0, torch.int8),
        (127, torch.int8),
        (128, torch.int16),
        (32_767, torch.int16),
        (32_768, torch.int32),
    ],
)
def test_whole_numbers_are_exact(largest, kind):
    numbers = torch.tensor([-1, 0, largest])
    kept = stored("bodies", numbers)
    assert isinstance(kept, torch.Tensor)
    assert kept.dtype == kind
    assert torch.equal(restored(kept), numbers)
    assert restored(stored("bodies", torch.zeros(0, dtype=torch.int64))).dtype == torch.int64


def test_motion_is_exact_and_the_rest_is_held_within_half_precision():
    motion = torch.tensor([[1e-7, 1e7, -3.14159265]])
    assert torch.equal(restored(stored("motion.velocities", motion)), motion)
    found = restored(stored("opacity_logits", torch.tensor([0.1, 1e9, -1e9])))
    assert found.tolist() == pytest.approx([0.1, HALF_MAX, -HALF_MAX], rel=1e-3)
