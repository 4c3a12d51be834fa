"""The field that training starts from: cells around the points of the sweep, opaque next to a point.

Letters: D layers, H rows, W columns, N points.
"""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.radiance_fields.frustum import Frustum
from reconstruction.radiance_fields.radiance_field import RadianceField, ShiftField
from reconstruction.scene_model import TimeSpan
from rigs.camera import Camera

AROUND = (3, 3, 4)  # reach of cells around a point, in nodes (rows, columns, layers)
SOLID = (2, 2, 0)  # reach of opaque cells: one layer, so that no surface starts in front of its points
LIGHT = ((0, 0, 0), (1, 1, 0), SOLID, AROUND)  # reaches tried in turn for points that give a cell its light
OPAQUE, CLEAR = 8.0, -4.5  # raw densities that take all, and 0.01 of the light in a layer


def seed_cells(still: tuple, moving: tuple, clip: TimeSpan, cameras: Sequence[Camera], seed: int = 0) -> RadianceField:
    """Return a field around points, each kind as positions [N, 3] in m and intensities [N] in spikes per tick.

    The moving points are canonical: their places before any deformation is learnt. `seed` is that of the deformation.
    """
    frustum = Frustum.around(np.concatenate([still[0], moving[0]]), cameras)
    parts = [_cells(frustum, *points) for points in (still, moving)]
    box = torch.tensor([[0, 0, 0], frustum.shape], dtype=torch.float32)
    shifts = ShiftField.over(box, torch.Generator().manual_seed(seed)) if len(parts[1][0]) else None
    densities, intensities = (torch.cat([part[i] for part in parts]) for i in (1, 2))
    return RadianceField(frustum, parts[0][0], parts[1][0], densities, intensities, shifts, clip)


def _cells(frustum: Frustum, positions: np.ndarray, intensities: np.ndarray) -> tuple[Tensor, Tensor, Tensor]:
    """Return the flat nodes [K] (sorted int32) of the cells around points [N, 3], raw densities and intensities [K]."""
    nodes = np.rint(np.nan_to_num(frustum.nodes(positions), nan=-1.0)).astype(np.int64)
    inside = ((nodes >= 0) & (nodes < frustum.shape)).all(axis=1)
    if not inside.any():
        return torch.zeros(0, dtype=torch.int32), torch.zeros(0), torch.zeros(0)
    flat, length = np.ravel_multi_index(tuple(nodes[inside].T), frustum.shape), int(np.prod(frustum.shape))
    sums = (np.bincount(flat, weights, length).astype(np.float32) for weights in (None, intensities[inside]))
    count, total = (grid.reshape(frustum.shape) for grid in sums)
    cells = np.flatnonzero(_gathered(count, AROUND) > 0.5)
    solid = _gathered(count, SOLID)[cells] > 0.5
    values = np.full(len(cells), np.nan, np.float32)
    for reach in LIGHT:
        counts, totals = (_gathered(grid, reach)[cells] for grid in (count, total))
        values = np.where(np.isnan(values) & (counts > 0.5), totals / np.maximum(counts, 0.5), values)
    raws = np.where(solid, np.float32(OPAQUE), np.float32(CLEAR))
    return torch.from_numpy(cells.astype(np.int32)), torch.from_numpy(raws), torch.from_numpy(values.astype(np.float32))


def _gathered(grid: NDArray[np.float32], reach: tuple[int, int, int]) -> NDArray[np.float32]:
    """Return the sums [H * W * D] of a grid [H, W, D] over the nodes within `reach` of each."""
    rows, columns, layers = (2 * r + 1 for r in reach)
    options = {"normalize": False, "borderType": cv2.BORDER_CONSTANT}
    flat = cv2.boxFilter(grid.reshape(-1, grid.shape[2]), -1, (layers, 1), **options).reshape(grid.shape)
    slices = [cv2.boxFilter(flat[..., k], -1, (columns, rows), **options) for k in range(grid.shape[2])]
    return np.stack(slices, axis=-1).ravel().astype(np.float32)
