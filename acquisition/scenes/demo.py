"""The demo scene, on which everything was developed. World frame: the centre camera's (x right, y down, z forward)."""

import math

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes import textures
from acquisition.scenes.bodies import Body, Finish, Shape, still
from acquisition.scenes.motion import GRAVITY_M_S2, Motion
from acquisition.scenes.scene import Scene
from rigs.transform import Transform

FLOOR_Y_M, WALL_Z_M = 0.62, 3.2
EVEN, DETAIL, SPECKLE, CHECKS, STRIPES, PEBBLES = range(6)


def fan_and_ball(seed: int) -> Scene:
    """A fan turning at 40 rad/s and a ball bouncing at about 1 m/s in a furnished corner 1.2 to 3.2 m away."""
    rng = np.random.default_rng([seed, 1])
    bodies = (*_room(rng), *_furniture(rng), _fan(rng), _ball(rng))
    images = textures.build(np.random.default_rng([seed, 0]))
    return Scene("fan_and_ball", seed, bodies, images, center=(0.0, 0.0, 1.8), to_sun=(-0.42, -0.5, -0.75))


def _finish(rng: np.random.Generator, texture: int, texel_m: float, low: float, high: float) -> Finish:
    u, v = rng.uniform(0, textures.SIZE, 2)
    return Finish(texture, texel_m, (low, high), (u, v))


def _nudge(rng: np.random.Generator, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The place moved by up to 3 cm sideways and in depth."""
    dx, dz = rng.uniform(-0.03, 0.03, 2)
    return x + dx, y, z + dz


def _about_x(angle_rad: float) -> NDArray[np.float64]:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


_UPRIGHT = Transform(_about_x(math.pi / 2), np.zeros(3))  # a cylinder's z along the vertical


def _room(rng: np.random.Generator) -> tuple[Body, Body]:
    wall = Shape("rectangle", (4.0, 3.0), _finish(rng, EVEN, 0.01, 0.1, 0.6))
    ground = Shape("rectangle", (4.0, 4.0), _finish(rng, SPECKLE, 0.015, 0.15, 0.8), _UPRIGHT)
    return still("wall", (0, FLOOR_Y_M - 3.0, WALL_Z_M), wall), still("floor", (0, FLOOR_Y_M, 2.0), ground)


def _furniture(rng: np.random.Generator) -> tuple[Body, ...]:
    def on_floor(x: float, height: float, z: float) -> tuple[float, float, float]:
        return _nudge(rng, x, FLOOR_Y_M - height / 2, z)

    crate = Shape("box", (0.14, 0.2, 0.12), _finish(rng, CHECKS, 0.0035, 0.05, 0.6))
    tower = Shape("box", (0.22, 0.5, 0.18), _finish(rng, DETAIL, 0.007, 0.4, 1.0))
    plinth = Shape("box", (0.17, 0.18, 0.17), _finish(rng, STRIPES, 0.004, 0.15, 0.85))
    column = Shape("cylinder", (0.13, 0.75), _finish(rng, PEBBLES, 0.006, 0.03, 0.4), _UPRIGHT)
    globe = Shape("sphere", (0.2,), _finish(rng, DETAIL, 0.006, 0.25, 1.0))
    board = Shape("rectangle", (0.42, 0.26), _finish(rng, CHECKS, 0.006, 0.1, 1.0))
    shelf = Shape("box", (0.4, 0.05, 0.15), _finish(rng, STRIPES, 0.0065, 0.3, 1.0))
    return (
        still("crate", on_floor(-0.56, 0.4, 1.32), crate, turn_rad=0.5),
        still("tower", on_floor(-1.12, 1.0, 2.6), tower, turn_rad=-0.4),
        still("plinth", (0.44, FLOOR_Y_M - 0.18, 1.62), plinth, turn_rad=0.25),
        still("column", on_floor(1.05, 1.5, 2.35), column),
        still("globe", on_floor(0.15, 0.4, 2.45), globe),
        still("board", _nudge(rng, 0.62, -0.55, 2.85), board, turn_rad=-0.3),
        still("shelf", _nudge(rng, -0.75, -0.72, 2.95), shelf),
    )


def _fan(rng: np.random.Generator) -> Body:
    """Four pitched blades around a hub, facing the cameras a little askew; the tips run at 14 m/s."""
    blades = []
    for quarter in range(4):
        angle = quarter * math.pi / 2
        c, s = math.cos(angle), math.sin(angle)
        around = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        body_from_shape = Transform(around @ _about_x(0.4), around @ np.array([0.205, 0, 0]))
        finish = _finish(rng, (CHECKS, PEBBLES, STRIPES, DETAIL)[quarter], 0.0045, 0.2, 1.0)
        blades.append(Shape("box", (0.15, 0.1, 0.006), finish, body_from_shape))
    hub = Shape("cylinder", (0.065, 0.045), _finish(rng, SPECKLE, 0.0035, 0.02, 0.5))
    aim = Transform.looking_at((0, 0, 0), (0.25, -0.1, 1.0))  # the axis is the body's z
    start = Transform(aim.rotation.T, np.array(_nudge(rng, -0.16, -0.1, 1.85)))
    axis = aim.rotation[2]
    return Body("fan", (*blades, hub), Motion(start, (axis[0], axis[1], axis[2]), spin_rad_s=40.0))


def _ball(rng: np.random.Generator) -> Body:
    """Bounces on the plinth without loss, turning as it goes; 1.2 m/s upwards at instant 0."""
    radius, speed = 0.13, 1.6
    gravity = GRAVITY_M_S2[1]
    start = Transform(np.eye(3), np.array([0.44, FLOOR_Y_M - 0.36 - radius, 1.62]))
    motion = Motion(
        start,
        spin_axis=(0.3, 0.2, 1.0),
        spin_rad_s=4.0,
        velocity_m_s=(0.0, -speed, 0.0),
        acceleration_m_s2=GRAVITY_M_S2,
        launch_s=-(speed - 1.2) / gravity,
        bounce_s=2 * speed / gravity,
    )
    return Body("ball", (Shape("sphere", (radius,), _finish(rng, PEBBLES, 0.0045, 0.02, 0.9)),), motion)
