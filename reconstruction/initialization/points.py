"""Depth maps to the points that become Gaussians: a random sample of every view's consistent pixels.

Letters: V views, N points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reconstruction.initialization.nearest import nearest
from reconstruction.initialization.sweep import DepthMap, back_project

NEIGHBOURS = 3


@dataclass(frozen=True, eq=False)
class Points:
    """Positions [N, 3] in m, linear intensities [N] in spikes per tick, spacing [N] in m, instants [N] in s."""

    positions: NDArray[np.float64]
    intensities: NDArray[np.float32]
    spacing: NDArray[np.float64]
    instants_s: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.positions)

    def select(self, which: NDArray) -> Points:
        """The points at indices, or where a mask is true."""
        return Points(self.positions[which], self.intensities[which], self.spacing[which], self.instants_s[which])

    @classmethod
    def none(cls) -> Points:
        """No points."""
        return cls(np.zeros((0, 3)), np.zeros(0, np.float32), np.zeros(0), np.zeros(0))

    @classmethod
    def joined(cls, parts: Sequence[Points]) -> Points:
        """All points of `parts`, in order."""
        if not parts:
            return cls.none()
        return cls(
            np.concatenate([p.positions for p in parts]),
            np.concatenate([p.intensities for p in parts]),
            np.concatenate([p.spacing for p in parts]),
            np.concatenate([p.instants_s for p in parts]),
        )


def sample_points(
    maps: Sequence[DepthMap],
    images: Sequence[NDArray[np.float32]],
    wanted: Sequence[NDArray[np.bool_]],
    count: int,
    instant_s: float,
    rng: np.random.Generator,
) -> Points:
    """At most `count` points drawn evenly from the pixels that are wanted and have a depth, of all V views."""
    positions, intensities = [], []
    for depth_map, image, mask in zip(maps, images, wanted, strict=True):
        kept = mask & np.isfinite(depth_map.depth)
        positions.append(back_project(depth_map.camera, depth_map.depth)[kept])
        intensities.append(image[kept])
    all_positions, all_intensities = np.concatenate(positions), np.concatenate(intensities)
    chosen = rng.permutation(len(all_positions))[:count]
    if len(chosen) == 0:
        return Points.none()
    positions_kept = all_positions[chosen]
    return Points(
        positions_kept, all_intensities[chosen], spacing(positions_kept), np.full(len(chosen), float(instant_s))
    )


def spacing(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean distance [N] in m to the nearest points; a point alone gets 1 cm."""
    if len(positions) < 2:
        return np.full(len(positions), 0.01)
    near = min(NEIGHBOURS, len(positions) - 1) + 1
    gaps, _ = nearest(positions, positions, near)
    return np.maximum(gaps[:, 1:].mean(axis=1), 1e-5)
