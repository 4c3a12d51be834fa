"""Infers depth where nothing has texture: a smooth region of a view is taken for a plane through its border's depths.

The inverse depth of a plane is affine in the pixels of a pinhole. A region's border belongs to the region itself, to a
neighbour that it touches, or to something nearer that hides it, never to something behind it. So the plane is the one
that most of the border lies on, and of which the rest lies in front. A region whose border does not say is left open.
Letters: H rows, W columns, B pixels of a border, R planes tried.
Source: Fischler & Bolles, "Random sample consensus", 1981; Sinha, Steedly and Szeliski, "Piecewise planar stereo for
image-based rendering", ICCV 2009.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.initialization.sweep import DepthMap, Image, SweepOptions, consistent
from reconstruction.initialization.texture import spread_of

PLAIN = 0.8  # share of textured pixels from which a view has no plain region worth a plane
SMOOTH_PX = 1.0  # blur before edges are looked for
EDGE = 1.2  # deviations of an image's noise that 3x3 blurred pixels spread by at the border of a region
CLOSED_PX = 2  # half the width of a gap in a border that is closed
LEAST_PIXELS = 40  # of a region, away from its border
REACH_PX = 5  # how far outside a region its border's depths are taken from
LEAST_BORDER = 12  # depths at the border of a region that a plane is laid through
LEAST_SUPPORT = 0.2  # least share of the border on the plane, less what lies behind it
TRIES = 256  # planes tried a region
ON_PLANE = 1.0  # inverse-depth steps that a border's depth may be off the plane
FLAT = 1e-4  # least determinant of three places, in widths of the picture, that a plane is laid through

Mask = NDArray[np.bool_]
Floats = NDArray[np.floating]


def with_planes(
    maps: Sequence[DepthMap],
    images: Sequence[Image],
    noises: Sequence[Image],
    sure: Sequence[Mask],
    options: SweepOptions,
    rng: np.random.Generator,
) -> list[DepthMap]:
    """Return the maps with depth only where there is texture, or where views agree on a plane inferred between.

    `sure` are the textured pixels. Without a plain region the depths stay as they are.
    """
    kept = [replace(m, depth=np.where(mask, m.depth, np.float32(np.nan))) for m, mask in zip(maps, sure, strict=True)]
    if all(mask.mean() > PLAIN for mask in sure):
        return list(maps)
    whole = [inferred(*one, options, rng) for one in zip(kept, images, noises, strict=True)]
    return consistent(whole, options)


def inferred(found: DepthMap, image: Image, noise: Image, options: SweepOptions, rng: np.random.Generator) -> DepthMap:
    """Return the map with planes in its unknown regions without texture; what is known, or cannot be told, stays."""
    soft = np.asarray(cv2.GaussianBlur(image, (0, 0), SMOOTH_PX), np.float32)
    smooth = spread_of(soft, 1) < EDGE * noise
    narrow = np.ones((2 * CLOSED_PX + 1,) * 2, np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(
        cv2.erode(smooth.astype(np.uint8), narrow), connectivity=4
    )
    depth, known = found.depth.copy(), np.isfinite(found.depth)
    step = ON_PLANE * float(np.diff(options.inverse_depths[:2])[0])
    for label in range(1, count):
        if boxes[label, cv2.CC_STAT_AREA] < LEAST_PIXELS:
            continue
        rows, columns = _around(boxes[label], image.shape)
        core = (labels[rows, columns] == label).astype(np.uint8)
        region = (cv2.dilate(core, narrow) > 0) & smooth[rows, columns]
        plane = _plane_of(region, found.depth[rows, columns], step, rng)
        open_ = region & ~known[rows, columns]
        if plane is not None and open_.any():
            inverse = _places(region.shape) @ plane
            seen = open_ & (inverse.reshape(region.shape) > 1 / (2 * options.far_m))
            depth[rows, columns][seen] = 1 / inverse.reshape(region.shape)[seen]
    return replace(found, depth=depth)


def _around(box: NDArray[np.int32], shape: Sequence[int]) -> tuple[slice, slice]:
    """Return the rows and columns of a box [x, y, width, height, area] and what is in reach around it."""
    left, top, width, height, _ = (int(n) for n in box)
    rows = slice(max(top - REACH_PX, 0), min(top + height + REACH_PX, shape[0]))
    return rows, slice(max(left - REACH_PX, 0), min(left + width + REACH_PX, shape[1]))


def _places(shape: tuple[int, ...]) -> Floats:
    """Return column, row and 1 of every pixel [H * W, 3], in pixels over 100: numbers about 1."""
    rows, columns = np.indices(shape) / 100.0
    return np.stack([columns.ravel(), rows.ravel(), np.ones(rows.size)], axis=1)


def _plane_of(region: Mask, depth: Image, step: float, rng: np.random.Generator) -> Floats | None:
    """Return the plane [3] of a region as inverse depth over `_places`, None where the border does not tell."""
    size = 2 * REACH_PX + 1
    near = cv2.dilate(region.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    border = (near & np.isfinite(depth)).ravel()
    if border.sum() < LEAST_BORDER:
        return None
    places, inverse = _places(region.shape)[border], 1 / depth.ravel()[border].astype(np.float64)
    picked = rng.integers(len(places), size=(TRIES, 3))
    corners = places[picked]
    picked = picked[np.abs(np.linalg.det(corners)) > FLAT]
    if not len(picked):
        return None
    planes = np.linalg.solve(places[picked], inverse[picked][:, :, None])[:, :, 0]
    off = inverse - planes @ places.T  # [R, B]; above 0: nearer than the plane
    support = (np.abs(off) < step).mean(axis=1) - (off < -step).mean(axis=1)
    if not support.max() > LEAST_SUPPORT:
        return None
    return _settled(places, inverse, planes[support.argmax()], step)


def _settled(places: Floats, inverse: Floats, plane: Floats, step: float) -> Floats:
    """Return the plane of least squares through what lies on it."""
    for _ in range(4):
        on = np.abs(inverse - places @ plane) < step
        plane = np.linalg.lstsq(places[on], inverse[on], rcond=None)[0]
    return plane
