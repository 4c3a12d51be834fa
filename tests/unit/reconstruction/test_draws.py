"""Draws of views and instants: even over few steps, and the same again after a kill."""

import numpy as np
import pytest

from reconstruction.training.draws import Draws


@pytest.mark.parametrize("views", [1, 2, 8])
def test_every_round_has_each_view_once(views: int):
    draws = Draws(views, 0)
    rounds = [[draws.view() for _ in range(views)] for _ in range(5)]
    assert all(sorted(one) == list(range(views)) for one in rounds)
    assert views == 1 or len({tuple(one) for one in rounds}) > 1


@pytest.mark.parametrize("steps", [10, 37, 100])
def test_few_places_leave_no_wide_gap(steps: int):
    draws = Draws(8, 3)
    places = np.sort([draws.place(10_000) for _ in range(steps)]) / 10_000
    gaps = np.diff(places, append=places[0] + 1)
    assert gaps.max() < 2.7 / steps  # 1 / 2 at ten steps for numbers drawn each for itself


@pytest.mark.parametrize("count", [1, 2, 3, 97])
def test_places_are_below_their_count_and_reach_all_of_it(count: int):
    draws = Draws(1, 5)
    assert {draws.place(count) for _ in range(8 * count)} == set(range(count))


def test_each_view_sees_all_of_the_clip():
    draws, seen = Draws(8, 0), [[] for _ in range(8)]
    for _ in range(400):
        seen[draws.view()].append(draws.place(100))
    assert all(np.histogram(places, 5, (0, 100))[0].min() >= 4 for places in seen)


def test_a_restored_training_draws_as_an_undisturbed_one():
    def drawn(draws: Draws, count: int) -> list[tuple[int, int, float]]:
        return [(draws.view(), draws.place(100), draws.rng.random()) for _ in range(count)]

    draws = Draws(5, 1)
    drawn(draws, 7)
    state, after = draws.state(), Draws(5, 9)
    after.restore(state)
    assert drawn(after, 20) == drawn(draws, 20)


def test_seeds_differ():
    assert [Draws(8, 0).place(1000)] != [Draws(8, 1).place(1000)]
