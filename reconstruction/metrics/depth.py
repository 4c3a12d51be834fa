"""Depth errors along z against truth, in metres, without alignment: the rig gives the scale."""

import math

import numpy as np
from numpy.typing import NDArray

Depth = NDArray[np.float32]


def abs_rel(depth: Depth, truth: Depth, mask: NDArray[np.bool_] | None = None) -> float:
    """Return the mean of |depth - truth| / truth of maps [H, W] in m where both exist and in `mask`; NaN for none."""
    kept = _both(depth, truth, mask)
    return float(np.mean(np.abs(depth[kept] - truth[kept]) / truth[kept])) if kept.any() else math.nan


def delta_1_25(depth: Depth, truth: Depth, mask: NDArray[np.bool_] | None = None) -> float:
    """Return the share of pixels [H, W] with a true depth whose ratio to it is below 1.25 both ways.

    Depths are in m; a missing one counts as wrong. NaN where there is no true depth in `mask`.
    """
    wanted = np.isfinite(truth) if mask is None else np.isfinite(truth) & mask
    if not wanted.any():
        return math.nan
    kept = _both(depth, truth, mask)
    ratio = np.maximum(depth[kept] / truth[kept], truth[kept] / depth[kept])
    return float((ratio < 1.25).sum() / wanted.sum())


def _both(depth: Depth, truth: Depth, mask: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    kept = np.isfinite(depth) & np.isfinite(truth) & (depth > 0)
    return kept if mask is None else kept & mask
