"""Things thrown and colliding: each flies freely between the instants at which two of them meet.

All fall alike, so seen from one of them the others fly straight, and the instant of a meeting is a quadratic's root.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.motion import GRAVITY_M_S2, Motion, Poses, Vector
from rigs.transform import Transform

GRAVITY = np.array(GRAVITY_M_S2)


@dataclass(frozen=True)
class Thrown:
    """A ball, or a box that is only met head-on on a face `radius_m` from its middle, at instant 0."""

    position_m: Vector
    velocity_m_s: Vector
    radius_m: float
    mass_kg: float = 1.0
    spin_axis: Vector = (0.0, 0.0, 1.0)
    spin_rad_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Pieces:
    """One free flight after another; piece i holds from `starts_s` i (the first before that too) to the next one."""

    starts_s: tuple[float, ...]
    flights: tuple[Motion, ...]

    @property
    def moving(self) -> bool:
        """Whether the pose ever changes."""
        return any(flight.moving for flight in self.flights)

    def world_from_body(self, instants_s: NDArray[np.float64]) -> Poses:
        """Rotations [n, 3, 3] and translations [n, 3] in metres at `instants_s` [n]."""
        instants_s = np.asarray(instants_s, dtype=np.float64)
        piece = np.maximum(0, np.searchsorted(self.starts_s, instants_s, side="right") - 1)
        rotations, translations = np.empty((len(instants_s), 3, 3)), np.empty((len(instants_s), 3))
        for i, flight in enumerate(self.flights):
            rotations[piece == i], translations[piece == i] = flight.world_from_body(instants_s[piece == i])
        return rotations, translations


def thrown(things: Sequence[Thrown], until_s: float) -> tuple[Pieces, ...]:
    """The motion of each of `things`, which meet without friction or loss until `until_s`, then fly on."""
    now, current = 0.0, list(things)
    starts: list[list[float]] = [[0.0] for _ in things]
    flights = [[_flight(thing, 0.0)] for thing in things]
    while True:
        meetings = [(_meeting_s(a, b), i, j) for j, b in enumerate(current) for i, a in enumerate(current[:j])]
        after_s, i, j = min(meetings, default=(math.inf, 0, 0))
        if now + after_s > until_s:
            return tuple(Pieces(tuple(s), tuple(f)) for s, f in zip(starts, flights, strict=True))
        now += after_s
        current = [_later(thing, after_s) for thing in current]
        current[i], current[j] = _bounced(current[i], current[j])
        for k in (i, j):
            starts[k].append(now)
            flights[k].append(_flight(current[k], now))


def _flight(thing: Thrown, since_s: float) -> Motion:
    return Motion(
        Transform(np.eye(3), np.array(thing.position_m)),
        thing.spin_axis,
        thing.spin_rad_s,
        thing.velocity_m_s,
        GRAVITY_M_S2,
        launch_s=since_s,
    )


def _later(thing: Thrown, seconds: float) -> Thrown:
    velocity = np.array(thing.velocity_m_s)
    position = np.array(thing.position_m) + velocity * seconds + GRAVITY * seconds**2 / 2
    return replace(thing, position_m=tuple(position), velocity_m_s=tuple(velocity + GRAVITY * seconds))


def _meeting_s(a: Thrown, b: Thrown) -> float:
    """Seconds until |apart + closing s| is the sum of the radii, from outside; infinity where that never is."""
    apart = np.array(b.position_m) - np.array(a.position_m)
    closing = np.array(b.velocity_m_s) - np.array(a.velocity_m_s)
    square, along = closing @ closing, apart @ closing
    disc = along**2 - square * (apart @ apart - (a.radius_m + b.radius_m) ** 2)
    return float((-along - math.sqrt(disc)) / square) if along < 0 and disc > 0 else math.inf


def _bounced(a: Thrown, b: Thrown) -> tuple[Thrown, Thrown]:
    """Both after an elastic impact along the line of their centres: momentum and energy stay what they were."""
    apart = np.array(b.position_m) - np.array(a.position_m)
    normal = apart / np.linalg.norm(apart)
    velocity_a, velocity_b = np.array(a.velocity_m_s), np.array(b.velocity_m_s)
    push = 2 * a.mass_kg * b.mass_kg / (a.mass_kg + b.mass_kg) * ((velocity_b - velocity_a) @ normal) * normal
    return (
        replace(a, velocity_m_s=tuple(velocity_a + push / a.mass_kg)),
        replace(b, velocity_m_s=tuple(velocity_b - push / b.mass_kg)),
    )
