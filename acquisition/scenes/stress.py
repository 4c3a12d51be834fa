"""The stress scenes: each has one thing that reconstructions stumble over. None is for development or evaluation."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from acquisition.scenes.bodies import Body, Finish, Shape, about, at, still
from acquisition.scenes.fan import fan_of
from acquisition.scenes.light import Flicker, Uneven
from acquisition.scenes.linkage import Strip, Wave
from acquisition.scenes.motion import GRAVITY_M_S2, Motion, Vector
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Stage
from rigs.transform import Transform

NUMBER = 20
FLOOR_Y_M = 0.62
BURST_S = 0.008  # when the bodies of `burst` appear
FLICKER = Flicker(rate_hz=100.0, depth=0.8)
ACROSS = Uneven(slope=(0.5, -0.2, 0.0), offset=0.6, least=0.08)  # full light on the right, little on the left
DIM_WHITE, FAINT_WHITE, BRIGHT_WHITE = 0.01, 0.07, 0.95  # spikes per tick
STRIPS, STRIP_M = 33, 0.028


def static(seed: int) -> Scene:
    """Build a scene in which nothing moves."""
    return _turning("static", seed, spin_rad_s=0.0)


def stiff(seed: int) -> Scene:
    """Build a ball at 55 m/s, 12 pixels a millisecond in the lab rig, beside one that rolls at 0.3 m/s."""
    stage = Stage.numbered(seed, NUMBER)
    fast = crossing_ball(stage, "fast_ball", 0.1, (-0.55, -0.12, 1.55), 55.0, lane_m=4.0)
    slow = crossing_ball(stage, "slow_ball", 0.16, (0.1, 0.3, 1.8), 0.3, lane_m=6.0)
    return _scene("stiff", seed, _furnished(stage), fast, slow)


def flicker(seed: int) -> Scene:
    """Build a turning propeller in light that falls to a fifth 100 times a second."""
    return _turning("flicker", seed, flicker=FLICKER)


def outdoor(seed: int) -> Scene:
    """Build a turning propeller in light that is full on one side of the scene and 8 % of that on the other."""
    return _turning("outdoor", seed, uneven=ACROSS)


def dim(seed: int) -> Scene:
    """Build a turning propeller by 0.01 spikes a tick on white: a spike in 100 ticks at most."""
    return _turning("dim", seed, white=DIM_WHITE, background=DIM_WHITE / 30)


def bright(seed: int) -> Scene:
    """Build a turning propeller by 0.95 spikes a tick on white, twice the usual share of it in the shadows."""
    return _turning("bright", seed, white=BRIGHT_WHITE, ambient=0.6)


def burst(seed: int) -> Scene:
    """Build eight balls that are there all at once after 8 ms and fly apart at 3 m/s."""
    stage = Stage.numbered(seed, NUMBER)
    balls = []
    for n in range(8):
        angle = 2 * math.pi * n / 8 + 0.2
        out = np.array([math.cos(angle), math.sin(angle), 0.4 * math.cos(3 * angle)])
        start = Transform(np.eye(3), np.array([0.0, -0.05, 1.7]) + 0.24 * out)
        velocity = (3 * out[0], 3 * out[1], 3 * out[2])
        motion = Motion(start, (0, 0, 1), 20.0, velocity, GRAVITY_M_S2, launch_s=BURST_S)
        spark = stage.shape("sphere", (0.085,), Finish((DISCS, BLOCKS, CLOTH)[n % 3], 0.003, (0.03, 1.0)))
        balls.append(Body(f"spark{n}", (spark,), motion, from_s=BURST_S))
    return _scene("burst", seed, _furnished(stage), *balls)


def deforming(seed: int) -> Scene:
    """Build a sheet of 33 hinged strips 28 mm wide, not a smooth surface, that waves with its free end at 6 m/s."""
    stage = Stage.numbered(seed, NUMBER)
    start = at(-0.6, -0.08, 1.85, about(1, 0.15))
    wave = Wave(start, STRIPS, STRIP_M, swing_rad=0.6, rate_rad_s=60.0, pace_rad=2 * math.pi / 22)
    first = stage.shifted(Finish(DISCS, 0.0045, (0.03, 1.0)))
    u, v = first.shift
    prints = [replace(first, shift=(u + i * STRIP_M / first.texel_m, v)) for i in range(STRIPS)]
    shapes = tuple(Shape("rectangle", (STRIP_M / 2, 0.3), print_on) for print_on in prints)
    sheet = Body("sheet", shapes, tuple(Strip(wave, i) for i in range(STRIPS)))
    pole = Stage(stage.rng)
    pole.pillar("pole", (-0.63, 0.05, 1.85), 0.025, 0.57, Finish(BLOCKS, 0.003, (0.05, 0.9)))
    return _scene("deforming", seed, _furnished(stage), *pole.bodies, sheet)


def faint(seed: int) -> Scene:
    """Build a light card that slides at 15 m/s by 0.07 spikes a tick on white: it passes within a few spikes."""
    stage = _furnished(Stage.numbered(seed, NUMBER))
    face = stage.shape("rectangle", (0.22, 0.16), Finish(CLOTH, 0.006, (0.7, 1.0)))
    card = Body("card", (face,), Motion(at(-0.25, 0.0, 1.7), velocity_m_s=(15.0, 0.0, 0.0)))
    return _scene("faint", seed, stage, card, white=FAINT_WHITE, background=FAINT_WHITE / 30)


def _turning(name: str, seed: int, *, spin_rad_s: float = 50.0, **light: Any) -> Scene:
    stage = _furnished(Stage.numbered(seed, NUMBER))
    turning = fan_of(stage, "propeller", (-0.1, -0.08, 1.75), (0.2, -0.1, 1.0), (4, 0.15, 0.1), spin_rad_s)
    return _scene(name, seed, stage, turning, **light)


def _scene(name: str, seed: int, stage: Stage, *movers: Body, **light: Any) -> Scene:
    stage.bodies += movers
    return stage.scene(name, NUMBER, seed, **light)


def crossing_ball(stage: Stage, name: str, radius: float, place: Vector, speed_m_s: float, *, lane_m: float) -> Body:
    """Return a ball at `place` at instant 0, which crosses `lane_m` along x again and again."""
    x, y, z = place
    start, launch_s = at(-lane_m / 2, y, z), -(x + lane_m / 2) / speed_m_s
    velocity = (speed_m_s, 0.0, 0.0)
    motion = Motion(start, (0, 0, 1), 20.0, velocity, launch_s=launch_s, bounce_s=lane_m / speed_m_s)
    return Body(name, (stage.shape("sphere", (radius,), Finish(BLOCKS, 0.003, (0.03, 1.0))),), motion)


def _furnished(stage: Stage) -> Stage:
    """Add the still part, the same in every stress scene of one seed, and return the stage."""
    globe = stage.shape("sphere", (0.2,), Finish(CLOTH, 0.005, (0.1, 1.0)))
    stage.room(FLOOR_Y_M, Finish(CLOTH, 0.008, (0.02, 0.5)), Finish(DISCS, 0.006, (0.02, 0.5)))
    stage.block("crate", stage.near(0.62, 0.46, 1.42), (0.1, 0.16, 0.1), Finish(DISCS, 0.003, (0.03, 1.0)), 0.5)
    stage.block("tower", stage.near(-1.1, 0.1, 2.6), (0.2, 0.52, 0.18), Finish(BLOCKS, 0.006, (0.03, 1.0)), -0.4)
    stage.bodies.append(still("globe", stage.near(0.75, 0.42, 2.5), globe))
    stage.block("shelf", stage.near(-0.3, -0.78, 3.1), (0.5, 0.05, 0.15), Finish(BLOCKS, 0.007, (0.03, 1.0)))
    stage.marker((0.75, -0.62, 2.8), -0.15)
    return stage
