"""Depth maps of several views held against each other: a depth counts where enough others see the same surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from acquisition.native import Address
from reconstruction.initialization.sweep import DepthMap, SweepOptions, back_project
from reconstruction.native import Double, Int, kernel

AGREEING = 2  # other views that must confirm a depth
_confirm_depths = kernel("confirm_depths", Address, Int, Int, Address, Address, Address, Int, Int, Double, Address)
AGREEMENT_PX = 1.0  # how far, in inverse-depth steps, a confirming depth may lie


def consistent(maps: Sequence[DepthMap], options: SweepOptions, agreeing: int = AGREEING) -> list[DepthMap]:
    """The same depths with NaN wherever fewer than `agreeing` other views see the same surface."""
    tolerance = AGREEMENT_PX * float(np.diff(options.inverse_depths[:2])[0])
    checked = []
    for i, reference in enumerate(maps):
        others = [other for j, other in enumerate(maps) if j != i]
        votes = confirmations(reference, others, tolerance)
        kept = np.where(votes >= min(agreeing, len(others)), reference.depth, np.float32(np.nan))
        checked.append(DepthMap(reference.camera, kept.astype(np.float32), reference.cost))
    return checked


def confirmations(reference: DepthMap, others: Sequence[DepthMap], tolerance: float) -> NDArray[np.uint8]:
    """How many of the others [H, W] have a depth whose inverse is within `tolerance` (1/m) of the point's there."""
    camera = reference.camera
    depth = np.ascontiguousarray(reference.depth, dtype=np.float32)
    votes = np.zeros(depth.shape, np.uint8)
    for other in others:
        seen_by = other.camera
        other_from_reference = seen_by.cam_from_rig @ camera.cam_from_rig.inverse()
        rows = other_from_reference.rotation @ np.linalg.inv(camera.K)
        numbers = np.concatenate([rows.ravel(), other_from_reference.translation])
        pinhole = np.array([seen_by.fx, seen_by.fy, seen_by.cx, seen_by.cy])
        there = np.ascontiguousarray(other.depth, dtype=np.float32)
        _confirm_depths(depth, *depth.shape, numbers, pinhole, there, *there.shape, tolerance, votes)
    return votes


def confirmations_reference(reference: DepthMap, others: Sequence[DepthMap], tolerance: float) -> NDArray[np.uint8]:
    """Readable twin of `confirmations`."""
    votes = np.zeros(reference.depth.shape, np.uint8)
    points = back_project(reference.camera, reference.depth)
    for other in others:
        camera = other.camera
        in_other = camera.cam_from_rig.apply(points)
        z = np.where(in_other[..., 2] > 1e-6, in_other[..., 2], np.nan)
        u, v = in_other[..., 0] / z * camera.fx + camera.cx, in_other[..., 1] / z * camera.fy + camera.cy
        height, width = other.depth.shape
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        row, column = (np.floor(np.where(inside, a, 0)).astype(np.int64) for a in (v, u))
        with np.errstate(divide="ignore"):
            votes += inside & (np.abs(1 / other.depth[row, column].astype(np.float64) - 1 / z) <= tolerance)
    return votes
