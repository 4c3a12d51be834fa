"""Motion that goes on for any length of time: routes between stops, journeys without end, and pauses of everything.

All of it is a function of time alone. What is drawn for a journey depends on its number and not on those before it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from acquisition.errors import AcquisitionError
from acquisition.scenes.motion import Floats, Movement, Vector, turns

AT_REST: Vector = (0.0, 0.0, 0.0)


class Stop(NamedTuple):
    """A place on a route and how it is passed: at `velocity_m_s`, turned by `turn_rad`, turning at `turning_rad_s`."""

    at_s: float
    place_m: Vector
    velocity_m_s: Vector = AT_REST
    turn_rad: float = 0.0
    turning_rad_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Route(Movement):
    """A way from stop to stop by cubic Hermite pieces, turning about `axis`, at rest before and after them.

    Between two stops at one place and without speed the pose does not change by a bit. A route that hops rises by
    4 `hop_m` f (1 - f), where f is the part of the way along x, in units of `hop_length_m`, since the last touch.
    Raises AcquisitionError for stops that are not in the order of time.
    """

    stops: tuple[Stop, ...]
    axis: Vector = (0.0, 1.0, 0.0)
    hop_m: float = 0.0
    hop_length_m: float = 1.0

    def __post_init__(self) -> None:
        instants = [stop.at_s for stop in self.stops]
        if not instants or any(later <= earlier for earlier, later in itertools.pairwise(instants)):
            raise AcquisitionError(f"found stops at {instants} s", "one or more, each later than the one before")

    def _poses(self, instants_s: Floats) -> tuple[Floats, Floats]:
        ways = self._ways(instants_s)
        places = ways[:, :3].copy()
        part = (places[:, 0] / self.hop_length_m) % 1.0
        places[:, 1] -= 4 * self.hop_m * part * (1 - part)  # +y is down
        return turns(self.axis, ways[:, 3]), places

    def _ways(self, instants_s: Floats) -> Floats:
        """Return the place and the turn at each of `instants_s` [n, 4]."""
        times = np.array([stop.at_s for stop in self.stops])
        points = np.array([(*stop.place_m, stop.turn_rad) for stop in self.stops])
        if len(self.stops) == 1:
            return np.tile(points, (len(instants_s), 1))
        speeds = np.array([(*stop.velocity_m_s, stop.turning_rad_s) for stop in self.stops])
        at = np.clip(instants_s, times[0], times[-1])
        i = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
        length = (times[i + 1] - times[i])[:, None]
        u = (at - times[i])[:, None] / length
        bent = length * (u * (1 - u) ** 2 * speeds[i] - u**2 * (1 - u) * speeds[i + 1])
        return points[i] + (points[i + 1] - points[i]) * (u**2 * (3 - 2 * u)) + bent


@dataclass(frozen=True, eq=False)
class Journeys(Movement):
    """One route after another without end: number m begins at `begins_s` + m `period_s`, on a clock of its own.

    `route_of` gives the route of any whole number, negative ones too. It has to be done within the period.
    """

    route_of: Callable[[int], Route]
    period_s: float
    begins_s: float = 0.0

    def _poses(self, instants_s: Floats) -> tuple[Floats, Floats]:
        since = instants_s - self.begins_s
        numbers = np.floor(since / self.period_s)
        rotations, translations = np.empty((len(since), 3, 3)), np.empty((len(since), 3))
        for number in np.unique(numbers):
            now = numbers == number
            route = self.route_of(int(number))
            rotations[now], translations[now] = route.world_from_body(since[now] - number * self.period_s)
        return rotations, translations


@dataclass(frozen=True)
class Pauses:
    """Stretches in which nothing moves: one of `length_s` in each `period_s`, from `begin_of(n)` after its start.

    Everything slows down for `ramp_s` before it and gathers speed for as long after it.
    """

    begin_of: Callable[[int], float]
    length_s: float
    period_s: float
    ramp_s: float = 0.003

    def worked_s(self, instants_s: Floats) -> Floats:
        """Return the time that motion has gone on for at `instants_s` [n]: constant in a pause, to the bit."""
        instants_s = np.asarray(instants_s, dtype=np.float64)
        numbers = np.floor(instants_s / self.period_s)
        begins = np.array([self.begin_of(int(number)) for number in numbers])
        ramp, length = self.ramp_s, self.length_s
        before = instants_s - numbers * self.period_s - begins  # seconds since the pause began; negative before it
        slowing = np.clip(before + ramp, 0, ramp)
        gathering = np.clip(before - length, 0, ramp)
        moved = np.minimum(before + ramp, 0) + slowing * (1 - slowing / (2 * ramp)) + gathering**2 / (2 * ramp)
        moved = moved + np.maximum(before - length - ramp, 0)
        return numbers * (self.period_s - length - ramp) + (begins - ramp) + moved


@dataclass(frozen=True, eq=False)
class Paused(Movement):
    """A movement that rests while `pauses` last and goes on where it was."""

    movement: Movement
    pauses: Pauses

    def _poses(self, instants_s: Floats) -> tuple[Floats, Floats]:
        return self.movement.world_from_body(self.pauses.worked_s(instants_s))
