"""Routes, journeys and pauses: they pass their stops as they say, join without a jump, and rest to the bit."""

import numpy as np
import pytest

from acquisition.errors import AcquisitionError
from acquisition.scenes.motion import Motion
from acquisition.scenes.passing import DELIVERY_S, JOURNEY_S, Carrier, Lane, delivery_route, pass_route
from acquisition.scenes.routes import Journeys, Paused, Pauses, Route, Stop
from rigs.transform import Transform

PAUSES = Pauses(lambda n: 0.1 + 0.02 * (n % 3), length_s=0.04, period_s=0.4)
HALTING = Route(
    (
        Stop(0.0, (-1.0, 0.0, 2.0), (10.0, 0.0, 0.0)),
        Stop(0.15, (0.0, 0.0, 2.0)),
        Stop(0.2, (0.0, 0.0, 2.0)),
        Stop(0.4, (-1.0, 0.5, 2.0), (-8.0, 0.0, 0.0), 0.7, 1.0),
    )
)


def places(movement, instants_s):
    return movement.world_from_body(np.asarray(instants_s)).translations


def test_a_route_passes_its_stops_at_the_speed_they_state():
    for stop in HALTING.stops:
        np.testing.assert_allclose(places(HALTING, [stop.at_s])[0], stop.place_m, atol=1e-12)
    for stop, side in ((HALTING.stops[0], 1), (HALTING.stops[1], -1), (HALTING.stops[3], -1)):
        before, after = places(HALTING, sorted((stop.at_s, stop.at_s + side * 1e-7)))
        np.testing.assert_allclose((after - before) / 1e-7, stop.velocity_m_s, atol=1e-4)


def test_a_route_rests_to_the_bit_before_after_and_at_a_halt():
    for resting in ([-5.0, -0.1, 0.0], [0.4, 0.41, 99.0], np.linspace(0.15, 0.2, 20)):
        found = HALTING.world_from_body(np.asarray(resting))
        assert (found.translations == found.translations[0]).all()
        assert (found.rotations == found.rotations[0]).all()


def test_a_wheel_turns_as_far_as_it_rolls_and_a_hop_touches_where_it_says():
    rolling = Route((Stop(0, (-2, 0, 2), (8, 0, 0), -10, 40), Stop(0.5, (2, 0, 2), (8, 0, 0), 10, 40)), (0, 0, 1))
    times = np.linspace(0, 0.5, 9)
    x = places(rolling, times)[:, 0]
    turned = rolling.world_from_body(times).rotations
    np.testing.assert_allclose(turned[:, 0, 0], np.cos(x / 0.2), atol=1e-9)
    np.testing.assert_allclose(turned[:, 1, 0], np.sin(x / 0.2), atol=1e-9)
    hopping = Route((Stop(0, (-2, 0, 2), (8, 0, 0)), Stop(0.5, (2, 0, 2), (8, 0, 0))), hop_m=0.3, hop_length_m=1.0)
    np.testing.assert_allclose(places(hopping, [0.0, 0.0625, 0.125, 0.1875])[:, 1], [0, -0.3, 0, -0.3], atol=1e-9)


def test_one_stop_is_a_place():
    route = Route((Stop(0.0, (1.0, 2.0, 3.0), turn_rad=0.3),))
    np.testing.assert_allclose(places(route, [-1.0, 0.0, 5.0]), [[1, 2, 3]] * 3)


@pytest.mark.parametrize("stops", [(), (Stop(0.1, (0, 0, 0)), Stop(0.1, (1, 0, 0)))])
def test_stops_out_of_order_are_refused(stops):
    with pytest.raises(AcquisitionError, match="each later"):
        Route(stops)


def test_journeys_follow_one_another_at_any_instant():
    drawn = []

    def route_of(number):
        drawn.append(number)
        return Route((Stop(0.0, (number, 0, 2)), Stop(0.3, (number + 1, 0, 2))))

    journeys = Journeys(route_of, period_s=0.5, begins_s=0.1)
    times = np.array([-0.41, -0.2, 0.1, 0.25, 0.6, 1e6 + 0.1])
    np.testing.assert_allclose(places(journeys, times)[:, 0], [-1, -7 / 27, 0, 0.5, 1, 2e6], atol=1e-6)
    assert set(drawn) == {-2, -1, 0, 1, 2_000_000}


def test_pauses_stand_still_to_the_bit_and_lose_what_they_last():
    times = np.linspace(-0.9, 2.1, 30001)
    worked = PAUSES.worked_s(times)
    steps = np.diff(worked) / np.diff(times)
    assert (steps > -1e-9).all()
    assert (steps < 1 + 1e-6).all()
    assert np.abs(np.diff(worked)).max() < 1.0001 * np.diff(times).max()  # no jump
    for n in range(-2, 5):
        begin = 0.4 * n + PAUSES.begin_of(n)
        resting = PAUSES.worked_s(np.linspace(begin + 1e-9, begin + 0.04 - 1e-9, 50))
        assert (resting == resting[0]).all()
        lost = 0.4 - np.diff(PAUSES.worked_s(np.array([0.4 * n, 0.4 * n + 0.4])))
        assert lost == pytest.approx(PAUSES.length_s + PAUSES.ramp_s, abs=1e-12)


def test_what_is_paused_goes_on_where_it_was():
    flying = Motion(Transform.identity(), velocity_m_s=(3.0, 0.0, 0.0))
    times = np.linspace(0, 1, 101)
    np.testing.assert_allclose(places(Paused(flying, PAUSES), times)[:, 0], 3 * PAUSES.worked_s(times), atol=1e-12)


@pytest.mark.parametrize("lane", [Lane(0.3, 1.5, 0.3, 0.5), Lane(0.3, 2.5, 0.2, rolls_m=0.2, hop_m=0.3)])
def test_a_thing_passes_within_its_journey_from_edge_to_edge(lane):
    ends = set()
    for number in range(60):
        stops = pass_route(np.random.default_rng(number), lane).stops
        assert stops[0].at_s >= 0
        assert stops[-1].at_s <= JOURNEY_S + 1e-12
        assert {abs(stops[0].place_m[0]), abs(stops[-1].place_m[0])} == {lane.edge_m}
        ends.add((len(stops), np.sign(stops[0].place_m[0]), np.sign(stops[-1].place_m[0])))
        halts = [stop for stop in stops if stop.velocity_m_s[0] == 0]
        assert all(abs(stop.place_m[0]) < 0.31 * lane.edge_m for stop in halts)
    assert len(ends) == 6  # across, on and back, each way


@pytest.mark.parametrize(("from_right", "x"), [(False, -0.7), (False, 0.7), (True, -0.7)])
def test_a_carrier_leaves_the_place_in_the_middle_of_its_delivery(from_right, x):
    carrier = Carrier((0.0, 0.1, 0.0), (0.0, -0.3, 0.0), 0.2, from_right)
    place = np.array([x, 0.2, 2.5])
    for number in range(20):
        stops = delivery_route(np.random.default_rng(number), carrier, tuple(place)).stops
        assert stops[0].at_s > 0
        assert stops[-1].at_s < DELIVERY_S
        leaving = next(stop for stop in stops if stop.at_s == DELIVERY_S / 2)
        np.testing.assert_allclose(np.array(leaving.place_m) + carrier.hold_m, place, atol=1e-12)
        assert np.sign(stops[0].place_m[0]) == (1 if from_right else np.sign(x))
