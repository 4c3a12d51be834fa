"""The result of a training is the mean of its last steps."""

import pytest
import torch

from reconstruction.training.averaging import EVERY, SHARE, Averages


def seen(values: list[torch.Tensor], stages: list[float] | None = None) -> Averages:
    """Return averages that have seen one tensor take these values, one a step."""
    averages = Averages()
    for value, stage in zip(values, stages or [0.0] * len(values), strict=True):
        averages.see([("x", value.clone().requires_grad_())], stage)
    return averages


def put(averages: Averages, into: torch.Tensor) -> torch.Tensor:
    averages.put_into([("x", into)])
    return into


def expected(values: torch.Tensor) -> torch.Tensor:
    """Return the mean as its definition has it, in float64."""
    looks = values[EVERY - 1 :: EVERY].double()
    mean = looks[0].clone()
    for number, value in enumerate(looks[1:], start=2):
        weight = min(1.0, 1 / (SHARE * number))
        mean = (1 - weight) * mean + weight * value
    return mean


@pytest.mark.parametrize("steps", [4, 5, 7, 8, 63, 64, 68, 400, 1003])
def test_mean_reaches_back_a_share_of_the_steps(steps: int) -> None:
    values = torch.randn(steps, 5, generator=torch.Generator().manual_seed(steps))
    found = put(seen(list(values)), torch.zeros(5))
    assert torch.allclose(found.double(), expected(values), rtol=1e-5, atol=1e-6)


def test_mean_lies_nearer_to_the_optimum_than_single_steps() -> None:
    generator, place = torch.Generator().manual_seed(0), torch.full((1000,), 3.0)
    averages = Averages()
    for _ in range(600):
        place = place - 0.1 * (place + torch.randn(1000, generator=generator))  # a noisy gradient of place^2 / 2
        averages.see([("x", place.requires_grad_())], 0.0)
        place = place.detach()
    assert put(averages, torch.zeros(1000)).square().mean() < place.square().mean() / 2


@pytest.mark.parametrize("steps", [0, 1, EVERY - 1])
def test_without_a_look_tensors_stay_as_they_are(steps: int) -> None:
    averages = seen([torch.ones(3)] * steps)
    assert torch.equal(put(averages, torch.full((3,), 7.0)), torch.full((3,), 7.0))


def test_a_new_stage_begins_anew_for_movers_alone() -> None:
    averages, still, moving = Averages(), torch.randn(82, 2), torch.zeros(2)
    for step in range(82):
        now = torch.full((2,), 1.0 if step < 42 else 5.0)
        tensors = [("still.means", still[step]), ("moving.means", now)]
        averages.see([(name, value.clone().requires_grad_()) for name, value in tensors], step % 42 / 42)
    found = torch.zeros(2)
    averages.put_into([("still.means", found), ("moving.means", moving)])
    assert torch.equal(moving, torch.full((2,), 5.0))
    assert torch.allclose(found.double(), expected(still), rtol=1e-5, atol=1e-6)


def test_what_is_not_learnt_is_not_touched() -> None:
    averages = Averages()
    for _ in range(2 * EVERY):
        averages.see([("x", torch.ones(2)), ("empty", torch.zeros(0, 3).requires_grad_())], 0.0)
    assert torch.equal(put(averages, torch.zeros(2)), torch.zeros(2))


def test_state_goes_on_exactly() -> None:
    values = list(torch.randn(50, 3, generator=torch.Generator().manual_seed(1)))
    whole, halved = seen(values), seen(values[:23])
    resumed = Averages(**halved.state())
    for value in values[23:]:
        resumed.see([("x", value.requires_grad_())], 0.0)
    assert torch.equal(put(resumed, torch.zeros(3)), put(whole, torch.zeros(3)))


def test_huge_and_tiny_values_stay_finite() -> None:
    for size in (1e-30, 1e30):
        found = put(seen([torch.full((2,), size)] * 100), torch.zeros(2))
        assert torch.allclose(found, torch.full((2,), size))
