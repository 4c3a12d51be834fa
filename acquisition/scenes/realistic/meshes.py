"""Makes triangle meshes with texture coordinates in metres, and reads those of `pybullet_data`.

Letters: V vertices, F triangles. Axes are the rig's: x right, y down, z forward.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigs.transform import Transform

Floats = NDArray[np.float64]
_SIDES = (((1, 0, 0), (0, 1, 0)), ((-1, 0, 0), (0, 1, 0)), ((0, 1, 0), (0, 0, 1)), ((0, -1, 0), (0, 0, 1)))
_BOX_SIDES = (*_SIDES, ((0, 0, 1), (1, 0, 0)), ((0, 0, -1), (1, 0, 0)))  # the normal of each, and an edge


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles: `vertices` [V, 3] in metres, `faces` [F, 3], `uv` [V, 2] in metres.

    Each triangle is flat: what is round has triangles of a pixel or two.
    """

    vertices: Floats
    faces: NDArray[np.uint32]
    uv: Floats

    def moved(self, pose: Transform) -> Mesh:
        """Return the mesh under a rigid motion."""
        return replace(self, vertices=pose.apply(self.vertices))

    def scaled(self, factor: float) -> Mesh:
        """Return the mesh at another size, its texture with it."""
        return replace(self, vertices=self.vertices * factor, uv=self.uv * factor)


def joined(*meshes: Mesh) -> Mesh:
    """Return all the meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]
    parts = np.concatenate([m.vertices for m in meshes]), np.concatenate(faces), np.concatenate([m.uv for m in meshes])
    return Mesh(parts[0], parts[1].astype(np.uint32), parts[2])


def sheet(center: ArrayLike, across: ArrayLike, down: ArrayLike, steps: tuple[int, int] = (1, 1)) -> Mesh:
    """Return a parallelogram about `center` with half edges `across` and `down`; it faces across x down."""
    center, across, down = (np.asarray(v, dtype=np.float64) for v in (center, across, down))
    u, v = np.meshgrid(np.linspace(-1, 1, steps[0] + 1), np.linspace(-1, 1, steps[1] + 1))
    u, v = u.ravel(), v.ravel()
    row = steps[0] + 1
    corner = (np.arange(steps[1])[:, None] * row + np.arange(steps[0])).ravel()
    squares = np.stack([corner, corner + 1, corner + row + 1, corner, corner + row + 1, corner + row], axis=1)
    uv = np.stack([(u + 1) * np.linalg.norm(across), (v + 1) * np.linalg.norm(down)], axis=1)
    return Mesh(center + u[:, None] * across + v[:, None] * down, squares.reshape(-1, 3).astype(np.uint32), uv)


def box(half: ArrayLike) -> Mesh:
    """Return a box of half sizes `half` [3] about the origin, each side with the texture as it would lie on it."""
    half = np.asarray(half, dtype=np.float64)
    sides = []
    for number, (normal, edge) in enumerate(_BOX_SIDES):
        normal, edge = np.array(normal), np.array(edge)
        other = np.cross(normal, edge)
        side = sheet(normal * half, edge * (half @ abs(edge)), other * (half @ abs(other)))
        sides.append(replace(side, uv=side.uv + 0.37 * number))
    return joined(*sides)


def ball(radius: float, rings: int = 48, squash: float = 1.0) -> Mesh:
    """Return a sphere about the origin, or an ellipsoid `squash` times as high as wide."""
    return _turned(np.linspace(-np.pi / 2, np.pi / 2, rings + 1), radius, 0.0, squash, 2 * rings)


def capsule(radius: float, half: float, rings: int = 32) -> Mesh:
    """Return a cylinder along z with round ends, its middles of ends at -half and half."""
    lows = np.linspace(-np.pi / 2, 0, rings // 2 + 1)
    return _turned(np.concatenate([lows, -lows[::-1]]), radius, half, 1.0, 2 * rings)


def drum(radius: float, half: float, sides: int = 64) -> Mesh:
    """Return a cylinder along z with flat ends."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    k = np.arange(sides)
    wall = np.concatenate([np.c_[rim, np.full(sides + 1, -half)], np.c_[rim, np.full(sides + 1, half)]])
    tops = np.concatenate([np.c_[k, k + 1, k + sides + 2], np.c_[k, k + sides + 2, k + sides + 1]])
    around = np.tile(angle * radius, 2)
    tube = Mesh(wall, tops.astype(np.uint32), np.c_[around, wall[:, 2]])
    ends = []
    for z, order in ((-half, (0, 2, 1)), (half, (0, 1, 2))):
        disc = np.concatenate([[[0.0, 0.0]], rim])
        fan = np.c_[np.zeros(sides, int), k + 1, k + 2][:, order]
        ends.append(Mesh(np.c_[disc, np.full(len(disc), z)], fan.astype(np.uint32), disc))
    return joined(tube, *ends)


def read_obj(path: Path) -> Mesh:
    """Read the triangles of a Wavefront file; one without texture coordinates gets its x and z."""
    places: list[list[float]] = []
    maps: list[list[float]] = []
    corners: dict[tuple[int, int], int] = {}
    faces: list[list[int]] = []
    for words in (line.split() for line in path.read_text(errors="replace").splitlines()):
        if words[:1] == ["v"]:
            places.append([float(word) for word in words[1:4]])
        elif words[:1] == ["vt"]:
            maps.append([float(word) for word in words[1:3]])
        elif words[:1] == ["f"]:
            at = [corners.setdefault(_corner(w, len(places), len(maps)), len(corners)) for w in words[1:]]
            faces += [[at[0], at[k], at[k + 1]] for k in range(1, len(at) - 1)]
    vertices = np.array([places[place] for place, _ in corners])
    uv = np.array([maps[m] for _, m in corners]) if maps else vertices[:, [0, 2]]
    return Mesh(vertices, np.array(faces, dtype=np.uint32), uv)


def _corner(word: str, places: int, maps: int) -> tuple[int, int]:
    place, picture = (int(part) if part else 0 for part in (*word.split("/"), "")[:2])
    return place - 1 if place > 0 else place + places, picture - 1 if picture > 0 else picture + maps


def _turned(tilts: Floats, radius: float, half: float, squash: float, around: int) -> Mesh:
    """Return a closed surface of revolution about z: circles at `tilts`, the upper ones `half` up, the others down."""
    turns = np.linspace(0, 2 * np.pi, around + 1)
    lifted = np.where(np.arange(len(tilts)) * 2 >= len(tilts), half, -half)
    tilt, turn = np.meshgrid(tilts, turns, indexing="ij")
    flat = radius * np.cos(tilt)
    high = squash * radius * np.sin(tilt) + lifted[:, None]
    vertices = np.stack([flat * np.cos(turn), flat * np.sin(turn), high], axis=-1).reshape(-1, 3)
    uv = np.stack([turn * radius, radius * tilt + lifted[:, None]], axis=-1).reshape(-1, 2)
    row = around + 1
    corner = (np.arange(len(tilts) - 1)[:, None] * row + np.arange(around)).ravel()
    quads = np.stack([corner, corner + 1, corner + row + 1, corner, corner + row + 1, corner + row], axis=1)
    return Mesh(vertices, quads.reshape(-1, 3).astype(np.uint32), uv)
