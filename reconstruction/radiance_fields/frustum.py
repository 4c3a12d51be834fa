"""The projective grid of a field: pixels of a camera in the middle of the array, and layers even in inverse depth.

A straight ray is straight in it, so a march needs no division. Letters: D layers, H rows, W columns, R rays, N points.
Source of the space: the normalised device coordinates of Mildenhall et al., "NeRF", ECCV 2020; here bounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rigs.camera import Camera
from rigs.transform import Transform

LAYER_PX = 1.0  # parallax between neighbouring layers for the outermost camera
MOST_LAYERS = 192
MARGIN = 4  # nodes beyond the outermost points on every side
OUTLIERS = 0.2  # percent of the points that are ignored at either end


@dataclass(frozen=True)
class Frustum:
    """Node (y, x, w) is at X fx - left = x, Y fy - top = y and 1 / z = nearest - w step, with X = x / z in the middle.

    `pose` is middle_from_rig as quaternion (w, x, y, z) and translation in m; inverse depths are in 1 / m.
    """

    pose: tuple[float, ...]
    focal: tuple[float, float]
    corner: tuple[float, float]
    nearest: float
    step: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, points: NDArray[np.float64], cameras: Sequence[Camera]) -> Frustum:
        """Return a frustum that holds `points` [N, 3] in m, of a camera amid `cameras` with their mean direction.

        Points some 30 times as far as the nearest ones and more are left out: MOST_LAYERS would not reach them.
        """
        centers = np.stack([c.center for c in cameras])
        middle = centers.mean(axis=0)
        forward = np.mean([c.cam_from_rig.rotation[2] for c in cameras], axis=0)
        down = np.mean([c.cam_from_rig.rotation[1] for c in cameras], axis=0)
        pose = Transform.looking_at(middle, middle + forward, down)
        focal = float(np.mean([c.fx for c in cameras])), float(np.mean([c.fy for c in cameras]))
        x, y, z = pose.apply(points).T
        seen = z > 0
        spots = np.stack([focal[0] * x[seen] / z[seen], focal[1] * y[seen] / z[seen], 1 / z[seen]])
        low, high = np.percentile(spots, (OUTLIERS, 100 - OUTLIERS), axis=1)
        parallax = focal[0] * float(np.linalg.norm(centers - middle, axis=1).max())
        low[2] = max(low[2], (MARGIN + 2) * high[2] / MOST_LAYERS)  # what is farther is left out
        step = max(LAYER_PX / max(parallax, 1e-9), (high[2] - low[2]) / MOST_LAYERS)
        step = min(step, low[2] / (MARGIN + 2))  # the farthest layer is in front of infinity
        width, height = (int(np.ceil(high[i] - low[i])) + 2 * MARGIN + 1 for i in (0, 1))
        layers = int(np.ceil((high[2] - low[2]) / step)) + 2 * MARGIN + 1
        corner = float(low[0] - MARGIN), float(low[1] - MARGIN)
        numbers = (*pose.quat_wxyz.tolist(), *pose.translation.tolist())
        return cls(numbers, focal, corner, float(high[2] + MARGIN * step), float(step), (height, width, layers))

    @property
    def middle_from_rig(self) -> Transform:
        """Return the pose of the middle camera."""
        return Transform.from_quat_wxyz(np.array(self.pose[:4]), np.array(self.pose[4:]))

    def nodes(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points [N, 3] in m of the rig frame as nodes (y, x, w) [N, 3]; NaN behind the middle camera."""
        x, y, z = self.middle_from_rig.apply(points).T
        z = np.where(z > 0, z, np.nan)
        columns = self.focal[0] * x / z - self.corner[0], self.focal[1] * y / z - self.corner[1]
        return np.stack([columns[1], columns[0], (self.nearest - 1 / z) / self.step], axis=1)

    def positions(self, nodes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return nodes (y, x, w) [N, 3] in front of infinity as points [N, 3] in m of the rig frame."""
        y, x, w = nodes.T
        z = 1 / (self.nearest - w * self.step)
        spots = [(x + self.corner[0]) * z / self.focal[0], (y + self.corner[1]) * z / self.focal[1], z]
        return self.middle_from_rig.inverse().apply(np.stack(spots, axis=1))

    def rays(self, camera: Camera, columns: NDArray, rows: NDArray) -> Rays:
        """Return the rays of `camera` through the centres of the pixels in `columns` [R] and `rows` [R]."""
        spots = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
        turn = self.middle_from_rig.rotation @ camera.cam_from_rig.rotation.T
        across = (spots - [camera.cx, camera.cy, 0]) / [camera.fx, camera.fy, 1] @ turn.T
        origin = self.middle_from_rig.apply(camera.center)
        forward = np.where(across[:, 2] > 1e-6, across[:, 2], np.nan)
        ends = across[:, :2] / forward[:, None]
        shifts = (origin[:2] - origin[2] * ends) * self.focal
        starts = ends * self.focal + shifts * self.nearest - self.corner
        first = (self.nearest - 1 / origin[2]) / self.step if origin[2] > 0 else 0.0
        stretch = np.linalg.norm(across, axis=1) / forward
        lines = [starts, -shifts * self.step, stretch[:, None], np.full((len(rows), 1), max(first, 0.0))]
        packed = torch.from_numpy(np.nan_to_num(np.concatenate(lines, axis=1), nan=-1e9).astype(np.float32))
        return Rays(packed, torch.from_numpy(forward), float(origin[2]))

    def depths(self, rays: Rays, layers: Tensor) -> Tensor:
        """Return depths [R] in m along the camera's z where the rays meet `layers` [R], keeping NaN."""
        z = 1 / (self.nearest - layers.double() * self.step)
        return ((z - rays.origin_z) / rays.forward).float()


@dataclass(frozen=True, eq=False)
class Rays:
    """R rays. `lines` [R, 6] float32: x and y at layer 0, their change a layer, path over depth, the first layer.

    `forward` [R] float64: depth in the frustum for each metre of the camera's depth; NaN, with a line far outside,
    where a ray does not enter. `origin_z`: the camera's own depth in the frustum, m.
    """

    lines: Tensor
    forward: Tensor
    origin_z: float

    def __len__(self) -> int:
        return len(self.lines)
