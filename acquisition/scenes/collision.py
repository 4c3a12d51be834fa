"""`collision`: balls and boxes are thrown and hit one another in the air, for evaluation only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from acquisition.scenes.bodies import Body, Finish, Shape, at
from acquisition.scenes.motion import GRAVITY_M_S2, Floats, Motion, Movement, Vector
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Stage

NUMBER = 14
FLOOR_Y_M = 0.62
CLIP_S = 0.25  # later everything has left the view
FINISHES = tuple(Finish(texture, 0.003, (0.1, 1.0)) for texture in (DISCS, BLOCKS, CLOTH))
GRAVITY = np.array(GRAVITY_M_S2)

Aim = tuple[Vector, Vector, float]  # a place, the velocity there, and the instant
BALLS: tuple[tuple[str, float, float, Aim], ...] = (  # name, radius, mass, aim
    ("left_ball", 0.13, 1.0, ((-0.46, -0.17, 1.55), (4.0, -0.5, 0.3), 0.006)),
    ("right_ball", 0.11, 1.0, ((-0.24, -0.12, 1.55), (-3.5, 0.4, 0.2), 0.006)),
    ("high_ball", 0.12, 1.0, ((0.12, -0.45, 2.1), (0.6, 4.5, -0.5), 0.011)),
    ("low_ball", 0.14, 1.5, ((0.17, -0.2, 2.05), (-0.4, -3.5, 0.3), 0.011)),
    ("driver", 0.1, 0.7, ((0.32, 0.22, 1.6), (5.5, 0.0, 0.0), 0.009)),
    ("lone_ball", 0.12, 1.0, ((-0.55, 0.3, 2.3), (3.0, -3.5, 0.0), 0.0)),
)
BOX = ("struck_box", (0.12, 0.12, 0.12), 1.2, ((0.55, 0.22, 1.6), (-2.4, 0.0, 0.0), 0.009))
TUMBLERS = (
    ("red_box", (0.13, 0.07, 0.1), ((-0.5, 0.28, 1.75), (3.2, -2.0, 0.0), 0.0), (0.3, 1.0, 0.5), 45.0),
    ("tall_box", (0.06, 0.16, 0.07), ((0.75, -0.3, 2.2), (-4.5, -1.0, 0.3), 0.0), (1.0, 0.2, 0.6), -50.0),
)


def collision(seed: int) -> Scene:
    """Build six balls and three boxes in the air at 2 to 6 m/s; within 10 ms three pairs hit, elastic, closed form."""
    stage = Stage.numbered(seed, NUMBER)
    stage.room(FLOOR_Y_M, Finish(BLOCKS, 0.008, (0.01, 0.6)), Finish(DISCS, 0.006, (0.02, 0.6)))
    stage.block("bench", stage.near(0.0, 0.5, 2.6), (0.7, 0.12, 0.15), Finish(CLOTH, 0.006, (0.04, 0.6)))
    stage.block("crate", stage.near(-0.62, 0.48, 1.4), (0.11, 0.14, 0.11), Finish(DISCS, 0.003, (0.03, 1.0)), 0.5)
    stage.pillar("post", stage.near(1.15, 0.0, 2.5), 0.09, 0.62, Finish(BLOCKS, 0.006, (0.03, 1.0)))
    stage.block("case", stage.near(-1.2, 0.1, 2.9), (0.25, 0.52, 0.2), Finish(DISCS, 0.007, (0.02, 0.6)), -0.3)
    _throw_things(stage)
    stage.marker((0.62, -0.68, 2.75), -0.1)
    return stage.scene("collision", NUMBER, seed)


def _throw_things(stage: Stage) -> None:
    things: list[tuple[str, Shape, Thrown]] = []
    for number, (name, radius, mass, aim) in enumerate(BALLS):
        spin = tuple(stage.rng.uniform(-1, 1, 3) + np.array([0, 0, 2]))
        shape = stage.shape("sphere", (radius,), FINISHES[number % 3])
        things.append((name, shape, _aimed(aim, radius, mass, spin, 15.0)))
    name, half, mass, aim = BOX
    things.append((name, stage.shape("box", half, FINISHES[1]), _aimed(aim, half[0], mass)))
    for name, half, aim, axis, spin_rad_s in TUMBLERS:
        things.append((name, stage.shape("box", half, FINISHES[0]), _aimed(aim, 0.01, 1.0, axis, spin_rad_s)))
    motions = thrown([throw for _, _, throw in things], CLIP_S)
    stage.bodies += [Body(name, (shape,), motion) for (name, shape, _), motion in zip(things, motions, strict=True)]


def _aimed(
    aim: Aim, radius_m: float, mass_kg: float, spin_axis: Vector = (0.0, 0.0, 1.0), spin_rad_s: float = 0.0
) -> Thrown:
    """Return the thing at instant 0 that would fly through its aim if it did not fall; all of them fall alike."""
    (x, y, z), (vx, vy, vz), instant_s = aim
    start = (x - vx * instant_s, y - vy * instant_s, z - vz * instant_s)
    return Thrown(start, (vx, vy, vz), radius_m, mass_kg, spin_axis, spin_rad_s)


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
class Pieces(Movement):
    """One free flight after another; piece i holds from `starts_s` i (the first before that too) to the next one."""

    starts_s: tuple[float, ...]
    flights: tuple[Motion, ...]

    def _poses(self, instants_s: Floats) -> tuple[Floats, Floats]:
        piece = np.maximum(0, np.searchsorted(self.starts_s, instants_s, side="right") - 1)
        rotations, translations = np.empty((len(instants_s), 3, 3)), np.empty((len(instants_s), 3))
        for i, flight in enumerate(self.flights):
            rotations[piece == i], translations[piece == i] = flight.world_from_body(instants_s[piece == i])
        return rotations, translations


def thrown(things: Sequence[Thrown], until_s: float) -> tuple[Pieces, ...]:
    """Return the motion of each of `things`, which meet without friction or loss until `until_s`, then fly on.

    All fall alike, so seen from one of them the others fly straight, and the instant of a meeting is a quadratic's
    root.
    """
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
    spin = (thing.spin_axis, thing.spin_rad_s)
    return Motion(at(*thing.position_m), *spin, thing.velocity_m_s, GRAVITY_M_S2, launch_s=since_s)


def _later(thing: Thrown, seconds: float) -> Thrown:
    velocity = np.array(thing.velocity_m_s)
    position = np.array(thing.position_m) + velocity * seconds + GRAVITY * seconds**2 / 2
    return replace(thing, position_m=tuple(position), velocity_m_s=tuple(velocity + GRAVITY * seconds))


def _meeting_s(a: Thrown, b: Thrown) -> float:
    """Return the seconds until |apart + closing s| falls to the sum of the radii; infinity where it never does."""
    apart = np.array(b.position_m) - np.array(a.position_m)
    closing = np.array(b.velocity_m_s) - np.array(a.velocity_m_s)
    square, along = closing @ closing, apart @ closing
    disc = along**2 - square * (apart @ apart - (a.radius_m + b.radius_m) ** 2)
    return float((-along - math.sqrt(disc)) / square) if along < 0 and disc > 0 else math.inf


def _bounced(a: Thrown, b: Thrown) -> tuple[Thrown, Thrown]:
    """Return both after an elastic impact along the line of their centres; momentum and energy are kept."""
    apart = np.array(b.position_m) - np.array(a.position_m)
    normal = apart / np.linalg.norm(apart)
    velocity_a, velocity_b = np.array(a.velocity_m_s), np.array(b.velocity_m_s)
    push = 2 * a.mass_kg * b.mass_kg / (a.mass_kg + b.mass_kg) * ((velocity_b - velocity_a) @ normal) * normal
    return (
        replace(a, velocity_m_s=tuple(velocity_a + push / a.mass_kg)),
        replace(b, velocity_m_s=tuple(velocity_b - push / b.mass_kg)),
    )
