"""Draws random scenes to train networks on: clutter of every kind, still to fast, 0.01 to 0.95 spikes a tick."""

import math

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import AcquisitionError
from acquisition.scenes import textures
from acquisition.scenes.bodies import Body, Finish, Shape, about, at
from acquisition.scenes.motion import GRAVITY_M_S2, Motion
from acquisition.scenes.scene import Scene
from rigs.camera import Camera
from rigs.transform import Transform

FOCAL_PX = 350.0  # focal length of the lab cameras
STILL_SHARE = 0.2  # share of the scenes without a mover; in the others three bodies in ten stand
SPEED_M_S = (0.4, 45.0)  # range of speeds, log-uniform; 45 m/s is 0.5 px a tick at 1.5 m
SPIN_RAD_S = (1.0, 200.0)  # range of spins, log-uniform, with no tip faster than SPEED_M_S
PIXEL_TEXELS = (0.35, 3.5)  # range of pixels a texel, log-uniform: the finest detail is finer or coarser than a pixel
BRIGHT, DIM = (0.3, 0.95), (0.01, 0.3)  # ranges of `white`: even for 8 of 10 scenes, log-uniform for the others


def random_camera(width: int, height: int) -> Camera:
    """Return a small camera with the lab cameras' lens, at the origin and looking along z."""
    return Camera("random", width, height, FOCAL_PX, FOCAL_PX, width / 2, height / 2, Transform.identity())


def random_scene(seed: int, middle_s: float = 0.0, field_px: int = 96) -> Scene:
    """Build scene number `seed`: 3 to 8 bodies before a wall, all within `field_px` of `random_camera` at `middle_s`.

    The same numbers give the same scene. Raises AcquisitionError for a negative seed or an empty field.
    """
    if seed < 0 or field_px < 1:
        raise AcquisitionError(f"found the seed {seed} and a field of {field_px} px", "from 0 and from 1")
    rng = np.random.default_rng([seed, 0x5C])
    still = rng.random() < STILL_SHARE
    wall_m = rng.uniform(2.0, 3.5)
    bodies = [_wall(rng, wall_m, middle_s, moves=not still and rng.random() < 0.25)]
    for number in range(rng.integers(3, 9)):
        depth_m = rng.uniform(1.0, wall_m - 0.3)
        center = (*(depth_m * field_px / FOCAL_PX * rng.uniform(-0.5, 0.5, 2)), depth_m)
        shapes, reach_m = _clutter(rng, depth_m, depth_m * field_px / FOCAL_PX)
        start = Transform(random_turn(rng), np.array(center))
        moves = not still and rng.random() < 0.7
        motion = _motion(rng, start, middle_s, reach_m) if moves else Motion(start)
        bodies.append(Body(f"body{number}", shapes, motion))
    to_sun = (rng.uniform(-1, 1), rng.uniform(-1, 0.3), -rng.uniform(0.2, 1.0))
    pictures = np.concatenate([textures.build(rng), np.stack([_collage(rng), _collage(rng)])])  # [8, S, S]
    white = rng.uniform(*BRIGHT) if rng.random() < 0.8 else _log_uniform(rng, *DIM)
    return Scene("random", seed, tuple(bodies), pictures, (0.0, 0.0, wall_m), to_sun, white, rng.uniform(0.1, 0.8))


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _collage(rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw rectangles of even grey over one another, wrapped round, 2 to 64 texels a side."""
    size = textures.SIZE
    image = np.full((size, size), rng.random(), dtype=np.float32)
    for _ in range(400):
        height, width = (2 ** rng.uniform(1, 6, 2)).astype(int)
        rows, columns = rng.integers(0, size, 2)
        image[np.ix_((rows + np.arange(height)) % size, (columns + np.arange(width)) % size)] = rng.random()
    return image


def _finish(rng: np.random.Generator, depth_m: float) -> Finish:
    low = rng.uniform(0.02, 0.5)
    high = low + (1 - low) * rng.uniform(0.2, 1.0)
    texel_m = _log_uniform(rng, *PIXEL_TEXELS) * depth_m / FOCAL_PX
    shift = rng.uniform(0, textures.SIZE, 2)
    return Finish(int(rng.integers(8)), texel_m, (low, high), (float(shift[0]), float(shift[1])))


def random_turn(rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw a rotation [3, 3], every one equally likely."""
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def _wall(rng: np.random.Generator, depth_m: float, middle_s: float, moves: bool) -> Body:
    """Return a board behind everything, a little askew, that moves sideways as before a panning camera or stands."""
    start = at(0, 0, depth_m, about(1, rng.uniform(-0.4, 0.4)))
    heading, speed = rng.uniform(0, 2 * math.pi), _log_uniform(rng, SPEED_M_S[0], 15.0) if moves else 0.0
    motion = Motion(start, velocity_m_s=(speed * math.cos(heading), speed * math.sin(heading), 0.0), launch_s=middle_s)
    return Body("wall", (Shape("rectangle", (3.0, 3.0), _finish(rng, depth_m)),), motion)


def _clutter(rng: np.random.Generator, depth_m: float, field_m: float) -> tuple[tuple[Shape, ...], float]:
    """Return one shape, or two to five thin blades about an axis, and how far it reaches from its origin in metres."""
    a, b, c = field_m * rng.uniform(0.04, 0.3, 3)
    kind = rng.choice(["box", "sphere", "cylinder", "rectangle", "blades"])
    if kind == "blades":
        return _blades(rng, depth_m, float(a), float(b)), float(2 * a)
    size = {"box": (a, b, c), "sphere": (a,), "cylinder": (a, b), "rectangle": (a, b)}[kind]
    return (Shape(kind, tuple(map(float, size)), _finish(rng, depth_m)),), float(math.hypot(*size))


def _blades(rng: np.random.Generator, depth_m: float, a: float, b: float) -> tuple[Shape, ...]:
    blades, count = [], int(rng.integers(2, 6))
    for angle in 2 * math.pi * np.arange(count) / count:
        around = about(2, angle)
        pose = Transform(around, around @ np.array([a, 0, 0]))
        blades.append(Shape("box", (a, min(b, 0.6 * a), 0.02 * a), _finish(rng, depth_m), pose))
    return tuple(blades)


def _motion(rng: np.random.Generator, start: Transform, middle_s: float, reach_m: float) -> Motion:
    """Draw spin, flight or both; the body is at `start` at `middle_s`."""
    way = rng.integers(3)
    heading = rng.standard_normal(3) * (1, 1, 0.3)
    velocity = heading / np.linalg.norm(heading) * (_log_uniform(rng, *SPEED_M_S) if way != 0 else 0.0)
    spin = _log_uniform(rng, *SPIN_RAD_S) if way != 1 else 0.0
    axis = rng.standard_normal(3) + np.array([0, 0, 2 * rng.integers(2)])
    return Motion(
        start,
        spin_axis=(float(axis[0]), float(axis[1]), float(axis[2])),
        spin_rad_s=float(min(spin, SPEED_M_S[1] / reach_m) * rng.choice([-1, 1])),
        velocity_m_s=(float(velocity[0]), float(velocity[1]), float(velocity[2])),
        acceleration_m_s2=GRAVITY_M_S2 if way == 2 else (0.0, 0.0, 0.0),
        launch_s=middle_s,
    )
