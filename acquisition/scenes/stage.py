"""What the natural-looking scenes are furnished with. World frame: the centre camera's (x right, y down, z forward)."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes import natural
from acquisition.scenes.bodies import Body, Finish, Shape, still
from acquisition.scenes.motion import Vector
from acquisition.scenes.scene import Scene
from rigs.transform import Transform

WALL_Z_M = 3.45
DISCS, BLOCKS, CLOTH, GLYPH = range(4)  # the pictures of every such scene, by number
FINE_M = 0.004  # metres a texel, about a pixel of the lab rig 1.4 m away
UPRIGHT = Transform(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.zeros(3))  # a cylinder's z along the vertical
LETTER = ("        ", " #####  ", " ##     ", " ##     ", " ####   ", " ##     ", " ##     ", "        ")  # F


class Look(NamedTuple):
    """A picture by its number, at so many metres a texel, its 0 and 1 mapped to these albedos."""

    picture: int
    texel_m: float
    low: float
    high: float


@functools.lru_cache(maxsize=8)  # a megabyte each picture
def pictures(seed: int, number: int) -> NDArray[np.float32]:
    """The textures [4, S, S] of scene `number`: leaves, blocks, cloth, and a black letter F on white."""
    rng = np.random.default_rng([seed, number, 0])
    cell = natural.SIZE // len(LETTER)
    letter = np.array([[mark == " " for mark in row] for row in LETTER], dtype=np.float32)
    panel = letter.repeat(cell, axis=0).repeat(cell, axis=1)
    return np.stack([natural.leaves(rng), natural.leaves(rng, square=True), natural.cloth(rng), panel])


def staged(name: str, number: int, seed: int, bodies: tuple[Body, ...], **light) -> Scene:
    """The scene of `bodies` around (0, 0, 1.9) in the light of an afternoon; `light` as Scene takes it."""
    kind = {"to_sun": (-0.36, -0.42, -0.83), "background": 0.02} | light
    return Scene(name, seed, bodies, pictures(seed, number), center=(0.0, 0.0, 1.9), mipmapped=True, **kind)


def placing(seed: int, number: int) -> np.random.Generator:
    """What shifts the textures and nudges the things of scene `number`."""
    return np.random.default_rng([seed, number, 1])


def finish(rng: np.random.Generator, look: Look) -> Finish:
    """The look, its picture shifted at random."""
    u, v = rng.uniform(0, natural.SIZE, 2)
    return Finish(look.picture, look.texel_m, (look.low, look.high), (u, v))


def nudged(rng: np.random.Generator, x: float, y: float, z: float, reach_m: float = 0.02) -> Vector:
    """The place moved by up to `reach_m` sideways and in depth."""
    dx, dz = rng.uniform(-reach_m, reach_m, 2)
    return x + dx, y, z + dz


def at(x: float, y: float, z: float, turned: NDArray[np.float64] | None = None) -> Transform:
    """`body_from_shape` of a shape there."""
    return Transform(np.eye(3) if turned is None else turned, np.array([x, y, z]))


def about(axis: int, angle_rad: float) -> NDArray[np.float64]:
    """The turn about the x, y or z axis (0, 1, 2) [3, 3]."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    turned = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turned[i, i], turned[i, j], turned[j, i], turned[j, j] = c, -s, s, c
    return turned


def room(rng: np.random.Generator, floor_y_m: float, wall: Look, ground: Look) -> tuple[Body, Body]:
    """A wall across the whole view and the ground before it."""
    upright = Shape("rectangle", (4.5, 3.5), finish(rng, wall))
    flat = Shape("rectangle", (4.5, 4.5), finish(rng, ground), UPRIGHT)
    return still("wall", (0, floor_y_m - 3.5, WALL_Z_M), upright), still("ground", (0, floor_y_m, 2.0), flat)


def marker(center: Vector, side_m: float, turn_rad: float = 0.0) -> Body:
    """A panel with the letter F, upright and legible for the cameras: no turn or mirror of it looks the same."""
    middle = (natural.SIZE - 1) / 2
    face = Finish(GLYPH, side_m / natural.SIZE, (0.03, 1.0), (middle, middle))
    return still("marker", center, Shape("rectangle", (side_m / 2, side_m / 2), face), turn_rad=turn_rad)


def block(name: str, center: Vector, half: Vector, skin: Finish, turn_rad: float = 0.0) -> Body:
    """A box that stands still."""
    return still(name, center, Shape("box", half, skin), turn_rad=turn_rad)


def pillar(name: str, center: Vector, radius: float, half: float, skin: Finish) -> Body:
    """An upright cylinder that stands still."""
    return still(name, center, Shape("cylinder", (radius, half), skin, UPRIGHT))
