"""Of bodies that were found in several ways those are kept that explain most, and no point rides on two."""

import numpy as np
import pytest

from reconstruction.initialization import choosing
from reconstruction.initialization.bodies import LONE, LONGEST, UNLIKE, Bodies
from reconstruction.initialization.choosing import PART_S, SEVERAL, USUAL, WHOLE_S, Way, choose_bodies, ways_within
from reconstruction.initialization.judging import Judgement
from reconstruction.initialization.points import Points

COUNT, INSTANTS = 200, 3
TIMES_S = [0.001, 0.002, 0.003]


def bodies_of(*ranges):
    """Bodies on ranges of the points, each told by the place it is at: 10 times its first point."""
    owners, reasons = np.full(COUNT, -1), np.full(COUNT, LONE, dtype=f"<U{LONGEST}")
    for number, own in enumerate(ranges):
        owners[list(own)], reasons[list(own)] = number, ""
    quats = np.tile([1.0, 0.0, 0.0, 0.0], (len(ranges), INSTANTS, 1))
    centers = np.array([[[10.0 * own.start, 0, 0]] * INSTANTS for own in ranges]).reshape(-1, INSTANTS, 3)
    seen = np.tile([0, INSTANTS - 1], (len(ranges), 1))
    return Bodies(owners, quats, centers, np.array(TIMES_S), seen, reasons)


@pytest.fixture
def choose(monkeypatch):
    """Chooses among sets of bodies, one a way, each with the gains of its bodies in spikes."""

    def chosen(*sets):
        ways = [Way(link=float(number)) for number in range(len(sets))]
        monkeypatch.setattr(choosing, "find_bodies", lambda points, instants_s, link, first: sets[int(link)][0])
        gains = {id(found): np.array(gain, dtype=float) for found, gain in sets}
        judge = lambda found: Judgement(100.0 - gains[id(found)], np.full(len(found), 100.0))  # noqa: E731
        return choose_bodies(Points.none(), TIMES_S, judge, ways)

    return chosen


def places(bodies):
    return bodies.centers[:, 0, 0].tolist()


def test_one_way_keeps_what_explains_the_counts(choose):
    found = choose((bodies_of(range(50), range(50, 100)), [10, -20]))
    assert (places(found.bodies), found.found) == ([0.0], 2)
    assert set(found.bodies.reasons[50:100]) == {UNLIKE}
    assert found.ratio == pytest.approx(0.9)


def test_two_bodies_that_explain_more_take_the_place_of_one(choose):
    found = choose((bodies_of(range(100)), [10]), (bodies_of(range(50), range(50, 100)), [20, 15]))
    assert places(found.bodies) == [0.0, 500.0]
    assert found.bodies.owners[:100].tolist() == [0] * 50 + [1] * 50
    assert set(found.bodies.reasons[:100]) == {""}
    assert found.found == 3


def test_one_body_that_explains_more_stays_whole(choose):
    found = choose((bodies_of(range(100)), [40]), (bodies_of(range(50), range(50, 100)), [20, 15]))
    assert places(found.bodies) == [0.0]
    assert (found.bodies.owners[:100] == 0).all()


def test_a_body_keeps_what_is_left_to_it_if_that_is_half(choose):
    half = choose((bodies_of(range(100)), [40]), (bodies_of(range(50, 150)), [20]))
    assert places(half.bodies) == [0.0, 500.0]
    assert (half.bodies.owners == 1).sum() == 50
    less = choose((bodies_of(range(100)), [40]), (bodies_of(range(40, 140)), [20]))
    assert places(less.bodies) == [0.0]
    assert (less.bodies.owners[100:] == -1).all()


def test_nothing_found_or_nothing_kept_is_no_body(choose):
    none = choose((bodies_of(), []), (bodies_of(), []))
    assert (len(none.bodies), none.ratio, none.found) == (0, 1.0, 0)
    refused = choose((bodies_of(range(60)), [-50]), (bodies_of(range(30, 90)), [-50]))
    assert len(refused.bodies) == 0
    assert set(refused.bodies.reasons[:60]) == {UNLIKE}
    assert set(refused.bodies.reasons[60:]) == {LONE}


def test_a_short_training_has_no_time_for_more_than_one_way():
    assert ways_within(None, PART_S) == ways_within(PART_S, PART_S) == SEVERAL
    assert ways_within(PART_S - 1, PART_S) == ways_within(WHOLE_S - 1, WHOLE_S) == USUAL
