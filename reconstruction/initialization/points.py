"""Turns depth maps into the points that become Gaussians: a random sample of every view's confirmed pixels.

Letters: V views, N points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from reconstruction.initialization.sweep import DepthMap, back_projected
from rigs.transform import Transform

if TYPE_CHECKING:
    from reconstruction.initialization.bodies import Bodies
    from reconstruction.scene_model import TimeSpan
    from rigs.camera import Camera

NEIGHBOURS = 3  # points that a point's spacing is measured to
SINGLE_TREE = 4  # FLANN's name for the k-d tree that searches exactly


@dataclass(frozen=True, eq=False)
class Points:
    """Positions [N, 3] in m, linear intensities [N] in spikes per tick, spacing [N] in m, instants [N] in s."""

    positions: NDArray[np.floating]
    intensities: NDArray[np.float32]
    spacing: NDArray[np.float64]
    instants_s: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.positions)

    def select(self, which: NDArray) -> Points:
        """Return the points at indices, or where a mask is true."""
        return Points(self.positions[which], self.intensities[which], self.spacing[which], self.instants_s[which])

    def moved(self, pose: Transform) -> Points:
        """Return the points carried by `pose`, in float32."""
        turn, shift = (np.asarray(a, np.float32) for a in (pose.rotation, pose.translation))
        return replace(self, positions=self.positions @ turn.T + shift)

    @classmethod
    def none(cls) -> Points:
        """Return no points."""
        return cls(np.zeros((0, 3)), np.zeros(0, np.float32), np.zeros(0), np.zeros(0))

    @classmethod
    def joined(cls, parts: Sequence[Points]) -> Points:
        """Return all points of `parts`, in order."""
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts or [cls.none()]]) for f in fields(cls)))


@dataclass(frozen=True)
class Seeds:
    """The start of every method: points of the still scene, and of movers swept at `instants` moments of `clip`.

    `cameras` are those that train. `bodies` reads the rigid bodies of the moving points. `seed` is that of all draws.
    The last `resting` of the moving points stand there all the time.
    """

    still: Points
    moving: Points
    clip: TimeSpan
    instants: int
    seed: int
    cameras: Sequence[Camera]
    bodies: Callable[[], Bodies]
    resting: int = 0


def sample_points(
    maps: Sequence[DepthMap],
    images: Sequence[NDArray[np.float32]],
    wanted: Sequence[NDArray[np.bool_]],
    count: int,
    instant_s: float,
    rng: np.random.Generator,
) -> Points:
    """Return at most `count` points, drawn evenly from the pixels of all V views that are wanted and have a depth.

    `images` [H, W] in spikes per tick and masks `wanted` [H, W] belong to the V `maps`; all points are of `instant_s`.
    """
    kept = [np.flatnonzero(mask & np.isfinite(m.depth)) for m, mask in zip(maps, wanted, strict=True)]
    ends = np.cumsum([0, *map(len, kept)])
    chosen = rng.permutation(int(ends[-1]))[:count]
    if len(chosen) == 0:
        return Points.none()
    positions, intensities = np.empty((len(chosen), 3)), np.empty(len(chosen), np.float32)
    for i, (depth_map, image) in enumerate(zip(maps, images, strict=True)):
        own = np.flatnonzero((chosen >= ends[i]) & (chosen < ends[i + 1]))
        pixels = kept[i][chosen[own] - ends[i]]
        positions[own], intensities[own] = back_projected(depth_map, pixels), image.ravel()[pixels]
    return Points(positions, intensities, spacing(positions), np.full(len(chosen), float(instant_s)))


def spacing(positions: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the mean distance [N] in m from points [N, 3] to their nearest ones; a point alone gets 1 cm."""
    if len(positions) < 2:
        return np.full(len(positions), 0.01)
    near = min(NEIGHBOURS, len(positions) - 1) + 1
    gaps, _ = nearest(positions, positions, near)
    return np.maximum(gaps[:, 1:].mean(axis=1), 1e-5)


def nearest(points: NDArray, others: NDArray, count: int = 1) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return distances [n, count] in m from each point [n, 3] to its nearest `others` [m, 3], and their indices.

    The nearest comes first. Distances are exact to float32, also far from the origin. `others` holds at least `count`
    points, `points` one. A k-d tree is searched, in place of a matrix of all distances.
    """
    import cv2  # which listing the methods does without

    middle = others.mean(axis=0)
    near, far = (np.ascontiguousarray(p - middle, dtype=np.float32) for p in (points, others))
    indices, squared = cv2.flann.Index(far, {"algorithm": SINGLE_TREE}).knnSearch(near, count, params={})
    order = np.argsort(squared, axis=1, kind="stable")
    distances = np.sqrt(np.take_along_axis(squared, order, axis=1).astype(np.float64))
    return distances, np.take_along_axis(indices, order, axis=1).astype(np.int64)
