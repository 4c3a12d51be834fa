"""Knows the light that still surfaces pass on to one another, as a lattice of irradiance from six directions.

The lattice is filled by tracing rays from each node, three times over, so light is passed on up to three times. A node
inside a thing takes its neighbours' light. Movers receive this light and do not change it.
Source: G. McTaggart, Half-Life 2 / Valve Source Shading, 2004 (ambient cubes).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.realistic.library import drjit, mitsuba
from acquisition.scenes.realistic.setting import Setting

SPACING_M = 0.25
RAYS = 384  # from a node
ROUNDS = 3
INSIDE = 0.3  # share of rays that meet a surface from behind, above which a node is inside a thing
_AXES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)


class PassedOn:
    """Irradiance at any place of a painter's setting, in spikes per tick times pi."""

    def __init__(self, setting: Setting):
        self._mi, self._dr = mitsuba(), drjit()
        self._low, self._high = (np.array(corner, dtype=np.float64) for corner in setting.corners)
        self._lattice = None

    def fill(self, painter: Any) -> None:
        """Trace what the painter's still surfaces pass on."""
        cells = np.ceil((self._high - self._low) / SPACING_M).astype(int)
        shape = tuple(int(count) for count in np.maximum(cells, 2))
        for _ in range(ROUNDS):
            self._lattice = self._mi.Texture3f(self._mi.TensorXf(self._traced(painter, shape)))

    def irradiance(self, places: Any, normals: Any) -> Any:
        """Return the irradiance of surfaces at `places` [n] that face `normals` [n]."""
        mi, dr = self._mi, self._dr
        if self._lattice is None:
            return mi.Float(0)
        low, size = mi.Point3f(*map(float, self._low)), mi.Vector3f(*map(float, self._high - self._low))
        six = self._lattice.eval((places + 0.4 * SPACING_M * normals - low) / size)
        found = mi.Float(0)
        for axis in range(3):
            along = normals[axis]
            found += along * along * dr.select(along > 0, six[2 * axis], six[2 * axis + 1])
        return found

    def _traced(self, painter: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Return the irradiance [z, y, x, 6] at the middle of each cell, from what surfaces scatter now."""
        from acquisition.scenes.realistic.rays import Rays, radiance

        mi, dr, nodes = self._mi, self._dr, int(np.prod(shape))
        k = dr.arange(mi.UInt32, nodes * RAYS)
        node, ray = k // RAYS, k % RAYS
        row = node // shape[0]
        cell = mi.Vector3f(mi.Float(node % shape[0]), mi.Float(row % shape[1]), mi.Float(row // shape[1]))
        size = mi.Vector3f(*map(float, (self._high - self._low) / np.array(shape)))
        origin = mi.Point3f(*map(float, self._low)) + (cell + 0.5) * size
        spread = [dr.gather(mi.Float, mi.Float(values), ray) for values in _spread()]
        direction = mi.Vector3f(*spread[:3])
        rays = Rays(mi.Ray3f(origin, direction), mi.Point2f(*spread[3:]))
        light, _ = radiance(painter, painter.still, rays, lit=False)
        hit = painter.still.ray_intersect(rays.ray)
        behind = dr.select(hit.is_valid() & (dr.dot(hit.n, direction) > 0), mi.Float(1), 0)
        cosines = [dr.dot(mi.Vector3f(*map(float, axis)), direction) for axis in _AXES]
        faces = [dr.select(cosine > 0, light * cosine, 0) for cosine in cosines]
        six = np.stack([np.array(dr.block_sum(face, RAYS)) for face in faces], axis=-1) * 4 * np.pi / RAYS
        inside = np.array(dr.block_sum(behind, RAYS)) / RAYS > INSIDE
        return _filled(six.reshape(*shape[::-1], 6), inside.reshape(shape[::-1])).astype(np.float32)


def _spread() -> NDArray[np.float32]:
    """Return directions all around [3] and places on the lamps [2] for RAYS rays, the same from every node.

    What they miss is then alike in neighbouring nodes, and no blotches show. Source: R. Swinbank and R. Purser, 2006
    (spirals on a sphere); M. Roberts, 2018 (places in a square).
    """
    k = np.arange(RAYS) + 0.5
    height, turn = 1 - 2 * k / RAYS, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - height**2)
    places = (k * 0.7548776662) % 1, (k * 0.5698402910) % 1
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height, *places]).astype(np.float32)


def _filled(six: NDArray, inside: NDArray[np.bool_]) -> NDArray:
    """Return the lattice with the mean of known neighbours in the nodes that are inside things."""
    known = ~inside
    six = np.where(known[..., None], six, 0.0)
    while not known.all() and known.any():
        total, count = np.zeros_like(six), np.zeros(known.shape)
        for axis in range(3):
            for step in (-1, 1):
                ahead, there = np.roll(six, step, axis), np.roll(known, step, axis)
                edge = [slice(None)] * 3
                edge[axis] = slice(0, 1) if step == 1 else slice(-1, None)
                there[tuple(edge)] = False
                total += np.where(there[..., None], ahead, 0)
                count += there
        reached = ~known & (count > 0)
        six[reached] = total[reached] / count[reached][:, None]
        known |= reached
    return six
