"""Builds the natural-looking scenes. World frame: the centre camera's (x right, y down, z forward)."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes import natural
from acquisition.scenes.bodies import UPRIGHT, Body, Finish, Kind, Shape, about, still
from acquisition.scenes.motion import Motion, Vector
from acquisition.scenes.scene import Scene
from rigs.transform import Transform

WALL_Z_M = 3.45
DISCS, BLOCKS, CLOTH, GLYPH = range(4)  # the textures of every such scene, by number
LETTER = ("        ", " #####  ", " ##     ", " ##     ", " ####   ", " ##     ", " ##     ", "        ")  # F


class Rotor(NamedTuple):
    """Blades around a hub: one finish a blade, their `half` sizes in metres, how far out their middles are, the hub."""

    blades: Sequence[Finish]
    half: Vector
    out_m: float
    pitch_rad: float
    hub: Shape


@dataclass
class Stage:
    """A scene in the making: `bodies` placed so far, with places and textures drawn from `rng`.

    Each call draws from the same random numbers, so the order of the calls decides what a seed gives. `texels` is the
    size of the textures, `nudge_m` the most by which `near` moves a place.
    """

    rng: np.random.Generator
    texels: int = natural.SIZE
    nudge_m: float = 0.02
    bodies: list[Body] = field(default_factory=list)

    @classmethod
    def numbered(cls, seed: int, number: int) -> Stage:
        """Return the empty stage of scene `number`."""
        return cls(np.random.default_rng([seed, number, 1]))

    def near(self, x: float, y: float, z: float) -> Vector:
        """Return the place moved a little sideways and in depth."""
        dx, dz = self.rng.uniform(-self.nudge_m, self.nudge_m, 2)
        return x + dx, y, z + dz

    def shifted(self, finish: Finish) -> Finish:
        """Return the finish with its texture shifted at random."""
        u, v = self.rng.uniform(0, self.texels, 2)
        return replace(finish, shift=(u, v))

    def shape(self, kind: Kind, size: tuple[float, ...], finish: Finish, pose: Transform | None = None) -> Shape:
        """Return a shape of this kind, size and pose in its body, its texture shifted at random."""
        return Shape(kind, size, self.shifted(finish), pose or Transform.identity())

    def room(self, floor_y_m: float, wall: Finish, ground: Finish) -> None:
        """Add a wall across the whole view and the ground before it."""
        upright = self.shape("rectangle", (4.5, 3.5), wall)
        flat = self.shape("rectangle", (4.5, 4.5), ground, UPRIGHT)
        self.bodies.append(still("wall", (0, floor_y_m - 3.5, WALL_Z_M), upright))
        self.bodies.append(still("ground", (0, floor_y_m, 2.0), flat))

    def block(self, name: str, center: Vector, half: Vector, finish: Finish, turn_rad: float = 0.0) -> None:
        """Add a box that stands still."""
        self.bodies.append(still(name, center, self.shape("box", half, finish), turn_rad=turn_rad))

    def pillar(self, name: str, center: Vector, radius: float, half: float, finish: Finish) -> None:
        """Add an upright cylinder that stands still."""
        self.bodies.append(still(name, center, self.shape("cylinder", (radius, half), finish, UPRIGHT)))

    def marker(self, center: Vector, turn_rad: float = 0.0) -> None:
        """Add a panel with the letter F, which no turn or mirror leaves legible, upright for the cameras."""
        side_m, middle = 0.42, (natural.SIZE - 1) / 2
        face = Finish(GLYPH, side_m / natural.SIZE, (0.03, 1.0), (middle, middle))
        panel = Shape("rectangle", (side_m / 2, side_m / 2), face)
        self.bodies.append(still("marker", center, panel, turn_rad=turn_rad))

    def propeller(self, name: str, center: Vector, faces: Vector, rotor: Rotor, spin_rad_s: float) -> Body:
        """Return, without adding it, a rotor near `center` that spins about the direction it `faces`."""
        shapes = []
        for number, finish in enumerate(rotor.blades):
            around = about(2, 2 * math.pi * number / len(rotor.blades))
            pose = Transform(around @ about(0, rotor.pitch_rad), around @ np.array([rotor.out_m, 0, 0]))
            shapes.append(self.shape("box", rotor.half, finish, pose))
        shapes.append(replace(rotor.hub, finish=self.shifted(rotor.hub.finish)))
        aim = Transform.looking_at((0, 0, 0), faces)  # the axis is the body's z
        start = Transform(aim.rotation.T, np.array(self.near(*center)))
        return Body(name, tuple(shapes), Motion(start, tuple(aim.rotation[2]), spin_rad_s))

    def scene(self, name: str, number: int, seed: int, **light: Any) -> Scene:
        """Return the scene of the bodies around (0, 0, 1.9) in the light of an afternoon; `light` as Scene takes it."""
        kind = {"to_sun": (-0.36, -0.42, -0.83), "background": 0.02} | light
        pictures, center = textures(seed, number), (0.0, 0.0, 1.9)
        return Scene(name, seed, tuple(self.bodies), pictures, center=center, mipmapped=True, **kind)


@functools.lru_cache(maxsize=8)  # a megabyte each texture
def textures(seed: int, number: int) -> NDArray[np.float32]:
    """Return the textures [4, S, S] of scene `number`: leaves, blocks, cloth, and a black letter F on white."""
    rng = np.random.default_rng([seed, number, 0])
    cell = natural.SIZE // len(LETTER)
    letter = np.array([[mark == " " for mark in row] for row in LETTER], dtype=np.float32)
    panel = letter.repeat(cell, axis=0).repeat(cell, axis=1)
    return np.stack([natural.leaves(rng), natural.leaves(rng, square=True), natural.cloth(rng), panel])
