"""Makes views without any training, from the same spikes at the same instants: a reconstruction must beat them.

`nearest_view` is the closest training camera's image as it is. `depth_blend` sweeps depth in the four nearest training
views, carries it into the wanted view, and blends the neighbours' pixels found along it.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.images.composite import shrunk
from reconstruction.initialization.sweep import (
    DepthMap,
    SweepOptions,
    back_project,
    consistent,
    depth_range_m,
    neighbours,
    sweep_view,
)
from reconstruction.initialization.warping import sampled
from reconstruction.scene_model import View
from rigs.camera import Camera

Image = NDArray[np.float32]
Posed = tuple[Camera, Image]
SPECK_PX = 5  # width of the median filter that removes stray points


def nearest_view(wanted: Camera, views: Sequence[Posed]) -> View:
    """Return the image of the training camera nearest to `wanted`, resized to its size where they differ, depthless."""
    (nearest,) = neighbours(wanted, [camera for camera, _ in views], 1)
    image = shrunk(views[nearest][1], wanted)
    return View(image, np.full_like(image, np.nan))


def depth_blend(wanted: Camera, views: Sequence[Posed]) -> View:
    """Return a blend of the four nearest views, warped by their swept depth; holes are closed from around them."""
    chosen = [views[i] for i in neighbours(wanted, [camera for camera, _ in views])]
    options = SweepOptions(*depth_range_m([camera for camera, _ in views]))
    swept = [sweep_view(view, [other for other in chosen if other is not view], options) for view in chosen]
    maps = consistent(swept, options)
    depth = np.asarray(cv2.medianBlur(_close_holes(_carry(wanted, maps)), SPECK_PX), dtype=np.float32)
    pairs = [sampled(wanted, depth, image, m) for (_, image), m in zip(chosen, maps, strict=True)]
    samples, visible = zip(*pairs, strict=True)
    total = np.sum(visible, axis=0)
    blend = np.sum([s * v for s, v in zip(samples, visible, strict=True)], axis=0) / np.maximum(total, 1e-9)
    plain = np.mean(samples, axis=0)
    return View(np.where(total > 0, blend, plain).astype(np.float32), depth)


def _carry(wanted: Camera, maps: Sequence[DepthMap]) -> Image:
    """Return the nearest surface of all maps as `wanted` sees it [H, W], NaN where none falls."""
    nearest = np.full(wanted.height * wanted.width, np.inf)
    for depth_map in maps:
        points = back_project(depth_map.camera, depth_map.depth)
        seen = wanted.cam_from_rig.apply(points[np.isfinite(depth_map.depth)])
        seen = seen[seen[:, 2] > 1e-3]
        x = seen[:, 0] / seen[:, 2] * wanted.fx + wanted.cx - 0.5
        y = seen[:, 1] / seen[:, 2] * wanted.fy + wanted.cy - 0.5
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):  # a point covers the four pixels around it
            column, row = np.floor(x).astype(int) + dx, np.floor(y).astype(int) + dy
            inside = (column >= 0) & (column < wanted.width) & (row >= 0) & (row < wanted.height)
            np.minimum.at(nearest, row[inside] * wanted.width + column[inside], seen[inside, 2])
    nearest[~np.isfinite(nearest)] = np.nan
    return nearest.reshape(wanted.height, wanted.width).astype(np.float32)


def _close_holes(depth: Image) -> Image:
    """Fill missing depths from the nearest known ones, farthest surface first."""
    filled = depth.copy()
    kernel = np.ones((3, 3), np.uint8)
    for _ in range(max(depth.shape)):
        missing = ~np.isfinite(filled)
        if not missing.any() or missing.all():
            return filled
        grown = cv2.dilate(np.where(missing, -1, filled).astype(np.float32), kernel)
        filled[missing & (grown > 0)] = grown[missing & (grown > 0)]
    return filled
