"""Learning rates as a training goes on: how they fall, and how far by its end."""

import pytest
import torch

from reconstruction.training.optimizer import FINAL, FINAL_LENGTH, SETTLING, anneal, final

KINDS = dict.fromkeys(("field", "moves", "length"), False)


def optimizer(values: tuple[float, ...] = (0.0,), **flags: bool) -> torch.optim.Optimizer:
    leaf = torch.tensor(values, requires_grad=True)
    return torch.optim.Adam([{"params": [leaf], "lr": 2.0, "start": 2.0, **KINDS, **flags}])


def rate(done: float, stage: float, steps: int, **flags: bool) -> float:
    adam = optimizer(**flags)
    anneal(adam, done, stage, steps, canonical_until=0.25)
    return adam.param_groups[0]["lr"]


def test_a_training_begins_at_the_first_rate():
    assert rate(0, 0, 0) == rate(0, 0, 0, length=True) == 2.0


@pytest.mark.parametrize("steps", [1, 10, 300])
def test_a_short_training_ends_at_a_third(steps: int):
    assert rate(1, 1, steps) == pytest.approx(2 * FINAL)


def test_a_long_training_ends_the_lower_the_longer_it_is():
    assert rate(1, 1, 1200) == pytest.approx(2 * SETTLING / 1200)
    assert final(10_000) < final(1200) < final(SETTLING / FINAL) == FINAL


def test_half_way_the_length_is_known_from_the_steps_so_far():
    assert rate(0.5, 0.5, 600) == pytest.approx(2 * (SETTLING / 1200) ** 0.5)


def test_lengths_end_at_a_share_of_their_own_however_long_it_takes():
    assert rate(1, 1, 300, length=True) == rate(1, 1, 9000, length=True) == pytest.approx(2 * FINAL_LENGTH)


def test_movers_end_at_a_third_of_their_stage_however_long_it_takes():
    assert rate(0.9, 1.0, 1080, moves=True) == rate(1, 1, 9000, moves=True) == pytest.approx(2 * FINAL)
    assert rate(0.9, 1.0, 1080) == pytest.approx(2 * (SETTLING / 1200) ** 0.9)


def test_a_deformation_waits_for_the_canonical_scene():
    assert rate(0.2, 0.2, 100, field=True) == 0.0 < rate(0.3, 0.3, 100, field=True)
