"""Moves things for any length of time: they pass on lanes, and a carrier puts boxes down.

Things enter the view, stop, turn back and leave it. No journey is like another: each is drawn from the seed and its
number. One stretch in PERIOD_S is still.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from acquisition.scenes.motion import Movement, Vector
from acquisition.scenes.routes import Journeys, Paused, Pauses, Route, Stop

SPAN_S = 0.02  # 400 planes of 20 kHz
PERIOD_S, STILL_S = 20 * SPAN_S, 2 * SPAN_S  # two spans in twenty are still
FIRST_STILL, STILL = (4, 6), (2, 17)  # spans in which the stretch may begin: of the first period, of the others
EARLY_S = 0.0005  # everything rests a little before the span begins, and after it ends
JOURNEY_S, DELIVERY_S = 0.42, 0.4  # motion in which a thing passes once, in which a box is brought
PASSES = CROSSES, GOES_ON, TURNS_BACK = range(3)
HALT_S = (0.012, 0.03)  # range of rests in the view
PUT_DOWN_S = 0.08  # motion before the first box stands
SHADOW_M = 0.7  # depth behind a thing that its shadow reaches


class Lane(NamedTuple):
    """The way on which a thing passes: its middle's height and depth, how far it reaches along x, and how it goes.

    `turns_rad` is the most that it turns about the vertical; one that has a `rolls_m` turns as a wheel of this radius.
    `hop_m` and `hop_length_m` are the height and the length of its hops.
    """

    y_m: float
    z_m: float
    half_m: float
    turns_rad: float = 0.0
    rolls_m: float = 0.0
    hop_m: float = 0.0
    hop_length_m: float = 1.0

    @property
    def edge_m(self) -> float:
        """Metres from the middle where the thing, and its shadow, are out of sight of every camera of the lab rig."""
        return edge_of(self.z_m, self.half_m)


def edge_of(z_m: float, half_m: float) -> float:
    """Return how far from the middle a thing at this depth is out of sight, that reaches `half_m` along x."""
    return 0.73 * (z_m + SHADOW_M) - 0.1 + half_m


class Carrier(NamedTuple):
    """A thing that brings boxes: it holds them `hold_m` from its middle, and comes and goes `lift_m` off their places.

    It reaches `half_m` along x to the middle of the view, and enters on the side of the place, or always `from_right`.
    """

    hold_m: Vector
    lift_m: Vector
    half_m: float
    from_right: bool = False


@dataclass
class Timetable:
    """The ways of things that move without end, all of them still in the same pauses; drawn from two numbers."""

    seed: int
    number: int
    pauses: Pauses = field(init=False)

    def __post_init__(self) -> None:
        self.pauses = Pauses(functools.lru_cache(self._still_from_s), STILL_S + 2 * EARLY_S, PERIOD_S)

    def _still_from_s(self, period: int) -> float:
        low, high = FIRST_STILL if period == 0 else STILL
        return SPAN_S * int(self._rng_of(0, period).integers(low, high + 1)) - EARLY_S

    def _rng_of(self, thing: int, journey: int) -> np.random.Generator:
        """Return the random numbers of one journey of one thing, which depend on no other."""
        return np.random.default_rng([self.seed, self.number, 2, thing, abs(journey), int(journey < 0)])

    def _paused(self, route_of: Callable[[int], Route], period_s: float, begins_s: float) -> Movement:
        return Paused(Journeys(functools.lru_cache(maxsize=64)(route_of), period_s, begins_s), self.pauses)

    def passing(self, lanes: Sequence[Lane]) -> list[Movement]:
        """Return how a thing passes on each lane; they set out one after another, evenly over JOURNEY_S."""
        return [
            self._paused(
                functools.partial(self._pass, lane, order + 1), JOURNEY_S, (order / len(lanes) - 0.75) * JOURNEY_S
            )
            for order, lane in enumerate(lanes)
        ]

    def _pass(self, lane: Lane, thing: int, journey: int) -> Route:
        return pass_route(self._rng_of(thing, journey), lane)

    def carrying(self, carrier: Carrier, places: Sequence[Vector]) -> tuple[Movement, list[Movement]]:
        """Return how a carrier comes and goes without end, and the boxes that it puts down on `places`, each for good.

        Box i stands from PUT_DOWN_S + i DELIVERY_S on, in time that motion has gone on for.
        """
        begins_s = PUT_DOWN_S - DELIVERY_S / 2

        def route_of(journey: int) -> Route:
            return delivery_route(self._rng_of(100, journey), carrier, places[journey % len(places)])

        boxes = [_until_put_down(route_of(i), carrier, begins_s + i * DELIVERY_S) for i in range(len(places))]
        moved = self._paused(functools.lru_cache(route_of), DELIVERY_S, begins_s)
        return moved, [Paused(box, self.pauses) for box in boxes]


def pass_route(rng: np.random.Generator, lane: Lane) -> Route:
    """Draw a journey that is done within JOURNEY_S: across the view, or with a halt in it and on, or back again."""
    ahead, kind = rng.choice((-1.0, 1.0)), int(rng.choice(PASSES))
    lasts_s = JOURNEY_S * rng.uniform(0.85, 1.0)
    start_s = rng.uniform(0, JOURNEY_S - lasts_s)
    halt_x, halt_s = 0.3 * lane.edge_m * rng.uniform(-1, 1), rng.uniform(*HALT_S)
    turned = lane.turns_rad * rng.uniform(-1, 1, 3)
    edge = lane.edge_m
    if kind == CROSSES:
        speed = 2 * edge / lasts_s
        ways = [(start_s, -edge, speed), (start_s + lasts_s, edge, speed)]
    else:
        far = edge if kind == GOES_ON else -edge
        speed = 1.5 * (halt_x + edge + abs(far - halt_x)) / (lasts_s - halt_s)  # slows down and gathers speed evenly
        stops_s = start_s + 1.5 * (halt_x + edge) / speed
        leaves = (start_s + lasts_s, far, speed if kind == GOES_ON else -speed)
        ways = [(start_s, -edge, speed), (stops_s, halt_x, 0.0), (stops_s + halt_s, halt_x, 0.0), leaves]
    turns = (turned[0], turned[1], turned[1], turned[2]) if len(ways) == 4 else (turned[0], turned[2])
    stops = tuple(_stop(lane, (t, ahead * x, ahead * v), turn) for (t, x, v), turn in zip(ways, turns, strict=True))
    axis = (0.0, 0.0, 1.0) if lane.rolls_m else (0.0, 1.0, 0.0)
    return Route(stops, axis, lane.hop_m, lane.hop_length_m)


def _stop(lane: Lane, way: tuple[float, float, float], turn_rad: float) -> Stop:
    at_s, x, speed = way
    place, velocity = (x, lane.y_m, lane.z_m), (speed, 0.0, 0.0)
    if lane.rolls_m:
        return Stop(at_s, place, velocity, x / lane.rolls_m, speed / lane.rolls_m)
    return Stop(at_s, place, velocity, turn_rad)


def delivery_route(rng: np.random.Generator, carrier: Carrier, place: Vector) -> Route:
    """Draw a carrier's way to a box's place, which it leaves in the middle of DELIVERY_S, and out again."""
    goal = np.array(place) - np.array(carrier.hold_m)
    above = goal + np.array(carrier.lift_m)
    side = 1.0 if carrier.from_right or place[0] > 0 else -1.0
    outside = np.array([side * edge_of(place[2], carrier.half_m), above[1], above[2]])
    lower_s, rest_s = 0.025, 0.006
    comes_s, goes_s = rng.uniform(0.135, 0.155, 2)
    middle_s = DELIVERY_S / 2
    speed_in, speed_out = (1.5 * (outside - above) / seconds for seconds in (comes_s, goes_s))
    ways = (
        (middle_s - rest_s - lower_s - comes_s, outside, -speed_in),
        (middle_s - rest_s - lower_s, above, np.zeros(3)),
        (middle_s - rest_s, goal, np.zeros(3)),
        (middle_s, goal, np.zeros(3)),
        (middle_s + lower_s, above, np.zeros(3)),
        (middle_s + lower_s + goes_s, outside, speed_out),
    )
    return Route(tuple(Stop(t, _vector(p), _vector(v)) for t, p, v in ways))


def _until_put_down(route: Route, carrier: Carrier, begins_s: float) -> Route:
    """Return the way of a carried box: along with the carrier until both rest at its place, where it stays for good."""
    hold = np.array(carrier.hold_m)
    return Route(
        tuple(
            Stop(begins_s + stop.at_s, _vector(np.array(stop.place_m) + hold), stop.velocity_m_s)
            for stop in itertools.islice(route.stops, 3)
        )
    )


def _vector(values: Any) -> Vector:
    x, y, z = map(float, values)
    return x, y, z
