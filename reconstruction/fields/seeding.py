"""Points of the sweep to the field that training starts from: cells around them, opaque next to a point.

Letters: D layers, H rows, W columns, N points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool3d, max_pool3d

from reconstruction.fields.field import RadianceField
from reconstruction.fields.frustum import Frustum
from reconstruction.fields.march import KNOT
from reconstruction.gaussians.dynamic import Clip
from rigs.camera import Camera

AROUND = (4, 3, 3)  # nodes (layers, rows, columns) from a point within which there are cells
SOLID = (1, 2, 2)  # within which they start opaque
OPAQUE, CLEAR = 1.0, -3.0  # raw densities: 0.73 and 0.05 of the light a layer
INSTANTS = 9  # knots of time


def seed_field(still: tuple, moving: tuple, clip: Clip, cameras: Sequence[Camera]) -> RadianceField:
    """A field around points, each kind as positions [N, 3] in m and intensities [N] in spikes per tick.

    The moving ones are canonical: where they are at rest before the deformation is learnt.
    """
    frustum = Frustum.around(np.concatenate([still[0], moving[0]]), cameras)
    parts = [_cells(frustum, *points) for points in (still, moving)]
    knots = [-(-size // knot) + 1 for size, knot in zip(frustum.shape, KNOT, strict=True)]
    offsets = torch.zeros(INSTANTS, *knots, 3) if len(parts[1][0]) else torch.zeros(0, 1, 1, 1, 3)
    densities, intensities = (torch.cat([part[i] for part in parts]) for i in (1, 2))
    return RadianceField(frustum, parts[0][0], parts[1][0], densities, intensities, offsets, clip)


def _cells(frustum: Frustum, positions: np.ndarray, intensities: np.ndarray) -> tuple[Tensor, Tensor, Tensor]:
    """Flat nodes (sorted int32) of the cells around points, their raw densities and intensities."""
    nodes = np.rint(np.nan_to_num(frustum.nodes(positions), nan=-1.0)).astype(np.int64)
    inside = ((nodes >= 0) & (nodes < frustum.shape)).all(axis=1)
    if not inside.any():
        return torch.zeros(0, dtype=torch.int32), torch.zeros(0), torch.zeros(0)
    flat = torch.from_numpy(np.ravel_multi_index(tuple(nodes[inside].T), frustum.shape))
    count, total = (torch.zeros(int(np.prod(frustum.shape))) for _ in range(2))
    count.index_add_(0, flat, torch.ones(len(flat)))
    total.index_add_(0, flat, torch.from_numpy(intensities[inside]).float())
    count, total = (grid.view(1, 1, *frustum.shape) for grid in (count, total))
    solid = _grown(count, SOLID).flatten() > 0
    cells = torch.nonzero(_grown(count, AROUND).flatten() > 0)[:, 0]
    near, far = ((_blurred(total, reach), _blurred(count, reach)) for reach in (SOLID, AROUND))
    values = [(sums.flatten()[cells] / counts.flatten()[cells].clamp_min(1e-9)) for sums, counts in (near, far)]
    raws = torch.where(solid[cells], OPAQUE, CLEAR)
    return cells.int(), raws, torch.where(solid[cells], *values)


def _grown(grid: Tensor, reach: tuple[int, int, int]) -> Tensor:
    """The largest value within `reach` nodes, axis by axis."""
    for axis, r in enumerate(reach):
        size, padding = [1, 1, 1], [0, 0, 0]
        size[axis], padding[axis] = 2 * r + 1, r
        grid = max_pool3d(grid, size, stride=1, padding=padding)
    return grid


def _blurred(grid: Tensor, reach: tuple[int, int, int]) -> Tensor:
    """The mean over as many nodes, axis by axis."""
    for axis, r in enumerate(reach):
        size, padding = [1, 1, 1], [0, 0, 0]
        size[axis], padding[axis] = 2 * r + 1, r
        grid = avg_pool3d(grid, size, stride=1, padding=padding)
    return grid
