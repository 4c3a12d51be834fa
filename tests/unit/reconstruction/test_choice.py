"""Which motion explains counts that nothing was made from."""

import pytest
import torch

from reconstruction.training.choice import between, count_error
from tests.unit.reconstruction.test_supervision import CLOCK, cloud, seen


def test_the_truth_misses_the_counts_by_less_than_what_stands_still():
    truth = cloud(0.8)
    view = seen(truth)
    planes = between([10, 30, 50])
    assert count_error(truth, [view], planes, CLOCK) < count_error(cloud(0.0), [view], planes, CLOCK)


def test_planes_between_neighbours():
    assert between([25, 75, 125]) == [50, 100]
    assert between([7]) == []


def test_nothing_to_compare_is_no_error():
    truth = cloud(0.0)
    view = seen(truth)
    assert not view.source.moving.any()
    assert count_error(truth, [view], [5], CLOCK) == 0.0
    assert count_error(truth, [], [5], CLOCK) == 0.0


@pytest.mark.parametrize("plane", [0, 10_000])
def test_a_window_is_cut_at_the_ends_of_the_clip(plane):
    truth = cloud(0.8)
    view = seen(truth)
    error = count_error(truth, [view], [min(plane, len(view.source.stream) - 1)], CLOCK)
    assert 0 < error < 9
    assert torch.isfinite(torch.tensor(error))
