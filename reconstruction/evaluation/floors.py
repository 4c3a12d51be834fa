"""Makes views without any training, from the same spikes at the same instants: a reconstruction must beat them.

`nearest_view` is the closest training camera's image as it is. `depth_blend` sweeps depth in the four nearest training
views, carries it into the wanted view, and blends the neighbours' pixels found along it.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.images.composite import shrunk
from reconstruction.initialization.pyramid import swept_maps
from reconstruction.initialization.sweep import DepthMap, SweepOptions, depth_range_m, neighbours
from reconstruction.initialization.warping import sampled
from reconstruction.scene_model import View
from rigs.camera import Camera

Image = NDArray[np.float32]
Posed = tuple[Camera, Image]
Places = NDArray[np.int64]
FAR_APART_PX = 2.0  # pixels between hypotheses; matching at half the size loses nothing then, and takes a quarter
SPECK_PX = 5  # width of the median filter that removes stray points


def nearest_view(wanted: Camera, views: Sequence[Posed]) -> View:
    """Return the image of the training camera nearest to `wanted`, resized to its size where they differ, depthless."""
    (nearest,) = neighbours(wanted, [camera for camera, _ in views], 1)
    image = shrunk(views[nearest][1], wanted)
    return View(image, np.full_like(image, np.nan))


def depth_blend(wanted: Camera, views: Sequence[Posed], span_m: tuple[float, float] | None = None) -> View:
    """Return a blend of the four nearest views, warped by their swept depth; holes are closed from around them.

    `span_m`: the nearest and farthest depth to search; None for what all `views` suggest.
    """
    chosen = [views[i] for i in neighbours(wanted, [camera for camera, _ in views])]
    options = SweepOptions(*(span_m or depth_range_m([camera for camera, _ in views])))
    maps = confirmed(chosen, options)
    depth = np.asarray(cv2.medianBlur(_close_holes(_carry(wanted, maps)), SPECK_PX), dtype=np.float32)
    pairs = [sampled(wanted, depth, image, m) for (_, image), m in zip(chosen, maps, strict=True)]
    samples, visible = zip(*pairs, strict=True)
    total = np.sum(visible, axis=0)
    blend = np.sum([s * v for s, v in zip(samples, visible, strict=True)], axis=0) / np.maximum(total, 1e-9)
    plain = np.mean(samples, axis=0)
    return View(np.where(total > 0, blend, plain).astype(np.float32), depth)


def confirmed(views: Sequence[Posed], options: SweepOptions) -> list[DepthMap]:
    """Return each view's confirmed depth, found at half the size where hypotheses are far apart at the whole one."""
    if _step_px([camera for camera, _ in views], options) >= FAR_APART_PX:
        small = confirmed([(camera.halved(), _halved(image)) for camera, image in views], options)
        return [_enlarged(one, camera) for one, (camera, _) in zip(small, views, strict=True)]
    cameras, images = zip(*views, strict=True)
    return swept_maps(cameras, images, options)


def _step_px(cameras: Sequence[Camera], options: SweepOptions) -> float:
    """Return how many pixels lie between neighbouring hypotheses in the two cameras that are farthest apart."""
    centers = np.stack([camera.center for camera in cameras])
    apart_m = np.linalg.norm(centers[:, None] - centers, axis=2).max()
    return float(apart_m * max(camera.fx for camera in cameras) * np.diff(options.inverse_depths[:2])[0])


def _halved(image: Image) -> Image:
    height, width = (side // 2 * 2 for side in image.shape)
    half = cv2.resize(image[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(half, dtype=np.float32)


def _enlarged(small: DepthMap, camera: Camera) -> DepthMap:
    """Return a map of half the size in the pixels of `camera`; an odd last row or column is unknown."""
    whole = [np.full((camera.height, camera.width), np.nan, np.float32) for _ in range(2)]
    for to, values in zip(whole, (small.depth, small.cost), strict=True):
        twice = values.repeat(2, axis=0).repeat(2, axis=1)
        to[: twice.shape[0], : twice.shape[1]] = twice
    return DepthMap(camera, *whole)


def _carry(wanted: Camera, maps: Sequence[DepthMap]) -> Image:
    """Return the nearest surface of all maps as `wanted` sees it [H, W], NaN where none falls."""
    nearest = np.full(wanted.height * wanted.width, np.inf)
    for depth_map in maps:
        x, y, z = _seen(wanted, depth_map)
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):  # a point covers the four pixels around it
            column, row = x + dx, y + dy
            inside = (column >= 0) & (column < wanted.width) & (row >= 0) & (row < wanted.height)
            np.minimum.at(nearest, (row * wanted.width + column)[inside], z[inside])
    nearest[~np.isfinite(nearest)] = np.nan
    return nearest.reshape(wanted.height, wanted.width).astype(np.float32)


def _seen(wanted: Camera, depth_map: DepthMap) -> tuple[Places, Places, NDArray[np.float64]]:
    """Return columns and rows [N] of the pixels of `wanted` above and left of a map's points, and depths [N] in m."""
    camera = depth_map.camera
    rows, columns = np.nonzero(np.isfinite(depth_map.depth))
    z = depth_map.depth[rows, columns].astype(np.float64)
    x, y = (columns + 0.5 - camera.cx) / camera.fx * z, (rows + 0.5 - camera.cy) / camera.fy * z
    there = wanted.cam_from_rig @ camera.cam_from_rig.inverse()
    x, y, z = (r[0] * x + r[1] * y + r[2] * z + t for r, t in zip(there.rotation, there.translation, strict=True))
    ahead = z > 1e-3
    x, y, z = x[ahead], y[ahead], z[ahead]
    x, y = x / z * wanted.fx + wanted.cx - 0.5, y / z * wanted.fy + wanted.cy - 0.5
    return np.floor(x).astype(int), np.floor(y).astype(int), z


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
