"""The stress scenes: each has one thing that reconstructions stumble over. None is for development or evaluation."""

from __future__ import annotations

import math

import numpy as np

from acquisition.scenes import stage
from acquisition.scenes.bodies import Body, Finish, Shape, still
from acquisition.scenes.fans import propeller
from acquisition.scenes.light import Flicker, Uneven
from acquisition.scenes.linkage import Strip, Wave
from acquisition.scenes.motion import GRAVITY_M_S2, Motion
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Look
from rigs.transform import Transform

NUMBER = 20
FLOOR_Y_M = 0.62
BURST_S = 0.008  # when the bodies of `burst` appear
FLICKER = Flicker(rate_hz=100.0, depth=0.8)
ACROSS = Uneven(slope=(0.5, -0.2, 0.0), offset=0.6, least=0.08)  # full light on the right, little on the left
DIM_WHITE, FAINT_WHITE, BRIGHT_WHITE = 0.01, 0.07, 0.95
STRIPS, STRIP_M = 33, 0.028


def static(seed: int) -> Scene:
    """Nothing moves."""
    rng = stage.placing(seed, NUMBER)
    return _scene("static", seed, (*_set(rng), _propeller(rng, 0.0)))


def stiff(seed: int) -> Scene:
    """A ball at 55 m/s, 12 pixels a millisecond in the lab rig, beside one that rolls at 0.3 m/s."""
    rng = stage.placing(seed, NUMBER)
    fast = _ball(rng, "fast_ball", 0.1, (-0.55, -0.12, 1.55), (55.0, 0.0, 0.0), lane_m=4.0)
    slow = _ball(rng, "slow_ball", 0.16, (0.1, 0.3, 1.8), (0.3, 0.0, 0.0), lane_m=6.0)
    return _scene("stiff", seed, (*_set(rng), fast, slow))


def flicker(seed: int) -> Scene:
    """A turning propeller in light that falls to a fifth 100 times a second."""
    return _turning("flicker", seed, flicker=FLICKER)


def outdoor(seed: int) -> Scene:
    """A turning propeller in light that is full on one side of the scene and 8 % of that on the other."""
    return _turning("outdoor", seed, uneven=ACROSS)


def dim(seed: int) -> Scene:
    """A turning propeller by 0.01 spikes a tick on white: a spike in 100 ticks at most."""
    return _turning("dim", seed, white=DIM_WHITE, background=DIM_WHITE / 30)


def bright(seed: int) -> Scene:
    """A turning propeller by 0.95 spikes a tick on white, and twice the share of it in the shadows."""
    return _turning("bright", seed, white=BRIGHT_WHITE, ambient=0.6)


def burst(seed: int) -> Scene:
    """Eight balls are there all at once after 8 ms and fly apart at 3 m/s."""
    rng = stage.placing(seed, NUMBER)
    balls = []
    for n in range(8):
        angle = 2 * math.pi * n / 8 + 0.2
        out = np.array([math.cos(angle), math.sin(angle), 0.4 * math.cos(3 * angle)])
        start = Transform(np.eye(3), np.array([0.0, -0.05, 1.7]) + 0.24 * out)
        velocity = (3 * out[0], 3 * out[1], 3 * out[2])
        motion = Motion(start, (0, 0, 1), 20.0, velocity, GRAVITY_M_S2, launch_s=BURST_S)
        skin = stage.finish(rng, Look((DISCS, BLOCKS, CLOTH)[n % 3], 0.003, 0.03, 1.0))
        balls.append(Body(f"spark{n}", (Shape("sphere", (0.085,), skin),), motion, from_s=BURST_S))
    return _scene("burst", seed, (*_set(rng), *balls))


def deforming(seed: int) -> Scene:
    """A sheet waves, its free end at up to 6 m/s: 33 hinged strips 28 mm wide, exactly those and no smooth surface."""
    rng = stage.placing(seed, NUMBER)
    start = Transform(stage.about(1, 0.15), np.array([-0.6, -0.08, 1.85]))
    wave = Wave(start, STRIPS, STRIP_M, swing_rad=0.6, rate_rad_s=60.0, pace_rad=2 * math.pi / 22)
    first = stage.finish(rng, Look(DISCS, 0.0045, 0.03, 1.0))
    u, v = first.shift
    shapes = []
    for i in range(STRIPS):
        print_on = Finish(first.texture, first.texel_m, first.albedo, (u + i * STRIP_M / first.texel_m, v))
        shapes.append(Shape("rectangle", (STRIP_M / 2, 0.3), print_on))
    sheet = Body("sheet", tuple(shapes), tuple(Strip(wave, i) for i in range(STRIPS)))
    pole = stage.pillar("pole", (-0.63, 0.05, 1.85), 0.025, 0.57, stage.finish(rng, Look(BLOCKS, 0.003, 0.05, 0.9)))
    return _scene("deforming", seed, (*_set(rng), pole, sheet))


def faint(seed: int) -> Scene:
    """A light card slides at 15 m/s by 0.07 spikes a tick on white: a few spikes in the whole time it takes to pass."""
    rng = stage.placing(seed, NUMBER)
    bodies = _set(rng)
    start = Transform(np.eye(3), np.array([-0.25, 0.0, 1.7]))
    face = Shape("rectangle", (0.22, 0.16), stage.finish(rng, Look(CLOTH, 0.006, 0.7, 1.0)))
    card = Body("card", (face,), Motion(start, velocity_m_s=(15.0, 0.0, 0.0)))
    return _scene("faint", seed, (*bodies, card), white=FAINT_WHITE, background=FAINT_WHITE / 30)


def _turning(name: str, seed: int, **light) -> Scene:
    rng = stage.placing(seed, NUMBER)
    return _scene(name, seed, (*_set(rng), _propeller(rng, 50.0)), **light)


def _propeller(rng: np.random.Generator, spin_rad_s: float) -> Body:
    return propeller(rng, "propeller", (-0.1, -0.08, 1.75), (0.2, -0.1, 1.0), (4, 0.15, 0.1), spin_rad_s)


def _scene(name: str, seed: int, bodies: tuple[Body, ...], **light) -> Scene:
    return stage.staged(name, NUMBER, seed, bodies, **light)


def _ball(
    rng: np.random.Generator,
    name: str,
    radius: float,
    place: tuple[float, float, float],
    velocity: tuple[float, float, float],
    *,
    lane_m: float,
) -> Body:
    """At `place` at instant 0; crosses `lane_m` along x again and again."""
    x, y, z = place
    speed = velocity[0]
    start = Transform(np.eye(3), np.array([-lane_m / 2, y, z]))
    motion = Motion(start, (0, 0, 1), 20.0, velocity, launch_s=-(x + lane_m / 2) / speed, bounce_s=lane_m / speed)
    return Body(name, (Shape("sphere", (radius,), stage.finish(rng, Look(BLOCKS, 0.003, 0.03, 1.0))),), motion)


def _set(rng: np.random.Generator) -> tuple[Body, ...]:
    """The still part, the same in every stress scene of one seed."""

    def skin(picture: int, texel_m: float, low: float, high: float) -> Finish:
        return stage.finish(rng, Look(picture, texel_m, low, high))

    globe = Shape("sphere", (0.2,), skin(CLOTH, 0.005, 0.1, 1.0))
    return (
        *stage.room(rng, FLOOR_Y_M, Look(CLOTH, 0.008, 0.02, 0.5), Look(DISCS, 0.006, 0.02, 0.5)),
        stage.block("crate", stage.nudged(rng, 0.62, 0.46, 1.42), (0.1, 0.16, 0.1), skin(DISCS, 0.003, 0.03, 1.0), 0.5),
        stage.block(
            "tower", stage.nudged(rng, -1.1, 0.1, 2.6), (0.2, 0.52, 0.18), skin(BLOCKS, 0.006, 0.03, 1.0), -0.4
        ),
        still("globe", stage.nudged(rng, 0.75, 0.42, 2.5), globe),
        stage.block("shelf", stage.nudged(rng, -0.3, -0.78, 3.1), (0.5, 0.05, 0.15), skin(BLOCKS, 0.007, 0.03, 1.0)),
        stage.marker((0.75, -0.62, 2.8), 0.42, -0.15),
    )
