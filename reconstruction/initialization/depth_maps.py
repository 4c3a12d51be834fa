"""Checks depth maps of several views against each other, and fills what is unknown."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.native import Address
from reconstruction.initialization.sweep import DepthMap, SweepOptions
from reconstruction.native import Double, Int, kernel

AGREEING = 2  # other views that must confirm a depth
AGREEMENT_PX = 1.0  # inverse-depth steps by which a confirming depth may be off

_confirm_depths = kernel("confirm_depths", Address, Int, Int, *[Address] * 3, Int, Int, Double, Address)


def consistent(maps: Sequence[DepthMap], options: SweepOptions, agreeing: int = AGREEING) -> list[DepthMap]:
    """Return the same depths with NaN wherever fewer than `agreeing` other views see the same surface."""
    tolerance = AGREEMENT_PX * float(np.diff(options.inverse_depths[:2])[0])
    checked = []
    for i, reference in enumerate(maps):
        others = [other for j, other in enumerate(maps) if j != i]
        votes = confirmations(reference, others, tolerance)
        kept = np.where(votes >= min(agreeing, len(others)), reference.depth, np.float32(np.nan))
        checked.append(DepthMap(reference.camera, kept.astype(np.float32), reference.cost))
    return checked


def confirmations(reference: DepthMap, others: Sequence[DepthMap], tolerance: float) -> NDArray[np.uint8]:
    """Return how many of the others [H, W] have a depth whose inverse is within `tolerance` (1/m) of the point's."""
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


def filled(depth_map: DepthMap) -> DepthMap:
    """Return the map with its unknown depths taken from the nearest known one, or unchanged where none is known.

    Where fewer than two other views confirm a depth there would be no points, and training grows none there: the
    border of the picture and the rims of occlusion stayed empty. On `fan_and_ball` this gained 1.0 dB after 1,500
    steps, more than a depth that one view confirms (0.4) or the farthest depth around (0.6).
    """
    unknown = ~np.isfinite(depth_map.depth)
    if unknown.all() or not unknown.any():
        return depth_map
    _, found = cv2.distanceTransformWithLabels(
        unknown.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    labels = np.asarray(found, dtype=np.int64)
    known = np.empty(int(labels.max()) + 1, dtype=np.float32)
    known[labels[~unknown]] = depth_map.depth[~unknown]
    return DepthMap(depth_map.camera, known[labels], depth_map.cost)
