"""`fan_and_ball`: the demo scene, on which everything was developed. World frame: the centre camera's."""

import math

import numpy as np

from acquisition.scenes import textures
from acquisition.scenes.bodies import Body, Finish, Shape, about, at, still
from acquisition.scenes.motion import GRAVITY_M_S2, Motion
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import Rotor, Stage
from rigs.transform import Transform

FLOOR_Y_M, WALL_Z_M = 0.62, 3.2
EVEN, DETAIL, SPECKLE, CHECKS, STRIPES, PEBBLES = range(6)
STANDING = Transform(about(0, math.pi / 2), np.zeros(3))  # a cylinder's z along the vertical


def fan_and_ball(seed: int) -> Scene:
    """Build a fan at 40 rad/s and a ball that bounces at about 1 m/s, in a furnished corner 1.2 to 3.2 m away."""
    stage = Stage(np.random.default_rng([seed, 1]), textures.SIZE, 0.03)
    wall = stage.shape("rectangle", (4.0, 3.0), Finish(EVEN, 0.01, (0.1, 0.6)))
    ground = stage.shape("rectangle", (4.0, 4.0), Finish(SPECKLE, 0.015, (0.15, 0.8)), STANDING)
    stage.bodies += still("wall", (0, FLOOR_Y_M - 3.0, WALL_Z_M), wall), still("floor", (0, FLOOR_Y_M, 2.0), ground)
    furnish(stage)
    stage.bodies += movers(stage)
    pictures = textures.build(np.random.default_rng([seed, 0]))
    to_sun = (-0.42, -0.5, -0.75)
    return Scene("fan_and_ball", seed, tuple(stage.bodies), pictures, center=(0.0, 0.0, 1.8), to_sun=to_sun)


def furnish(stage: Stage) -> None:
    """Add what stands around."""
    crate = stage.shape("box", (0.14, 0.2, 0.12), Finish(CHECKS, 0.0035, (0.05, 0.6)))
    tower = stage.shape("box", (0.22, 0.5, 0.18), Finish(DETAIL, 0.007, (0.4, 1.0)))
    plinth = stage.shape("box", (0.17, 0.18, 0.17), Finish(STRIPES, 0.004, (0.15, 0.85)))
    column = stage.shape("cylinder", (0.13, 0.75), Finish(PEBBLES, 0.006, (0.03, 0.4)), STANDING)
    globe = stage.shape("sphere", (0.2,), Finish(DETAIL, 0.006, (0.25, 1.0)))
    board = stage.shape("rectangle", (0.42, 0.26), Finish(CHECKS, 0.006, (0.1, 1.0)))
    shelf = stage.shape("box", (0.4, 0.05, 0.15), Finish(STRIPES, 0.0065, (0.3, 1.0)))
    stage.bodies += (
        still("crate", stage.near(-0.56, FLOOR_Y_M - 0.4 / 2, 1.32), crate, turn_rad=0.5),
        still("tower", stage.near(-1.12, FLOOR_Y_M - 1.0 / 2, 2.6), tower, turn_rad=-0.4),
        still("plinth", (0.44, FLOOR_Y_M - 0.18, 1.62), plinth, turn_rad=0.25),
        still("column", stage.near(1.05, FLOOR_Y_M - 1.5 / 2, 2.35), column),
        still("globe", stage.near(0.15, FLOOR_Y_M - 0.4 / 2, 2.45), globe),
        still("board", stage.near(0.62, -0.55, 2.85), board, turn_rad=-0.3),
        still("shelf", stage.near(-0.75, -0.72, 2.95), shelf),
    )


def movers(stage: Stage) -> tuple[Body, Body]:
    """Return the fan and the ball."""
    return _fan(stage), _ball(stage)


def _fan(stage: Stage) -> Body:
    """Return four pitched blades around a hub, facing the cameras a little askew; the tips run at 14 m/s."""
    blades = [Finish(texture, 0.0045, (0.2, 1.0)) for texture in (CHECKS, PEBBLES, STRIPES, DETAIL)]
    hub = Shape("cylinder", (0.065, 0.045), Finish(SPECKLE, 0.0035, (0.02, 0.5)))
    rotor = Rotor(blades, (0.15, 0.1, 0.006), 0.205, 0.4, hub)
    return stage.propeller("fan", (-0.16, -0.1, 1.85), (0.25, -0.1, 1.0), rotor, 40.0)


def _ball(stage: Stage) -> Body:
    """Return a ball that bounces on the plinth without loss, turning as it goes; 1.2 m/s upwards at instant 0."""
    radius, speed, gravity = 0.13, 1.6, GRAVITY_M_S2[1]
    motion = Motion(
        at(0.44, FLOOR_Y_M - 0.36 - radius, 1.62),
        spin_axis=(0.3, 0.2, 1.0),
        spin_rad_s=4.0,
        velocity_m_s=(0.0, -speed, 0.0),
        acceleration_m_s2=GRAVITY_M_S2,
        launch_s=-(speed - 1.2) / gravity,
        bounce_s=2 * speed / gravity,
    )
    return Body("ball", (stage.shape("sphere", (radius,), Finish(PEBBLES, 0.0045, (0.02, 0.9))),), motion)
