"""The pairs of views that are shown to the network, and its answers.

Letters: v views, n sampled pixels of each.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rigs.camera import Camera
from rigs.transform import Floats


@dataclass(frozen=True, eq=False)
class PairMaps:
    """The network's answer to two views, numbered `first` and `second`.

    `points` [2, n, 3]: of the first and of the second view's pixels, both in the first camera's frame, at a scale of
    the pair's own. `confidence` [2, n] >= 1, larger is better.
    """

    first: int
    second: int
    points: NDArray[np.float32]
    confidence: NDArray[np.float32]

    @property
    def weights(self) -> Floats:
        """Return the logarithm of the confidence [2, n]; 0 where a point is not finite."""
        usable = np.isfinite(self.points).all(axis=-1) & np.isfinite(self.confidence)
        return np.where(usable, np.log(np.maximum(np.where(usable, self.confidence, 1), 1)), 0).astype(np.float64)

    @property
    def finite_points(self) -> Floats:
        """Return the points [2, n, 3], zero where one is not finite."""
        points = self.points.astype(np.float64)
        return np.where(np.isfinite(points).all(axis=-1, keepdims=True), points, 0)


def complete(count: int) -> list[tuple[int, int]]:
    """Pair every view with every other, both ways round."""
    return [(a, b) for a in range(count) for b in range(count) if a != b]


def sampled_pixels(height: int, width: int, most: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and columns [n] of an even grid of at most `most` pixels."""
    stride = max(1, int(np.ceil(np.sqrt(height * width / most))))
    rows, columns = np.meshgrid(*(np.arange(stride // 2, side, stride) for side in (height, width)), indexing="ij")
    return rows.ravel(), columns.ravel()


def rays_of(cameras: Sequence[Camera], rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Floats:
    """Return where the pixels' centres look, as x / z and y / z [v, n, 2] in camera axes, without lens distortion."""
    pixels = np.stack([columns + 0.5, rows + 0.5], axis=-1)[:, None]
    rays = [cv2.undistortPoints(pixels, c.K, np.array(c.distortion))[:, 0] for c in cameras]
    return np.stack(rays).astype(np.float64)
