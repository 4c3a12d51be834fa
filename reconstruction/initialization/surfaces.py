"""Infers depth where nothing has texture: a smooth region of a view is taken for a plane through its border's depths.

The inverse depth of a plane is affine in the pixels of a pinhole. A region's border belongs to the region itself, to a
neighbour that it touches, or to something nearer that hides it, never to something behind it. So the plane is the one
that most of the border lies on, and of which the rest lies in front. A region whose border does not say is left open.
Letters: H rows, W columns, B pixels of a border, R planes tried.
Source: Fischler & Bolles, "Random sample consensus", 1981; Sinha, Steedly and Szeliski, "Piecewise planar stereo for
image-based rendering", ICCV 2009.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.initialization.sweep import DepthMap, Image, SweepOptions, consistent
from reconstruction.initialization.texture import spread_of

PLAIN = 0.8  # share of textured pixels from which a view has no plain region worth a plane
SMOOTH_PX = 1.0  # blur before edges are looked for
EDGE = 1.2  # deviations of an image's noise that 3x3 blurred pixels spread by at the border of a region
CLOSED_PX = (10, 7, 5, 4, 3, 2)  # half the widths of gaps in borders that are closed, one after the other
GROWTH_PX = 6  # by which regions grow from one width to the next
LEAST_PIXELS = 40  # of a region, away from its border
REACH_PX = 5  # how far outside a region its border's depths are taken from
LEAST_BORDER, MOST_BORDER = 12, 400  # depths at the border of a region that a plane is laid through
LEAST_SUPPORT = 0.2  # least share of the border on the plane, less what lies behind it
TRIES = 256  # planes tried a region
ON_PLANE = 1.0  # inverse-depth steps that a border's depth may be off the plane
FLAT = 1e-4  # least determinant of three places, in widths of the picture, that a plane is laid through

AROUND = np.ones((3, 3), np.uint8)
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
    labels = regions(spread_of(soft, 1) < EDGE * noise)
    depth, known = found.depth.copy(), np.isfinite(found.depth)
    step = ON_PLANE * float(np.diff(options.inverse_depths[:2])[0])
    for label, box in _boxes(labels):
        region = labels[box] == label
        down, across = np.nonzero(region & ~known[box])
        plane = _plane_of(region, found.depth[box], step, rng) if len(down) else None
        if plane is not None:
            inverse = _places(down, across) @ plane
            seen = inverse > 1 / (2 * options.far_m)
            depth[box][down[seen], across[seen]] = 1 / inverse[seen]
    return replace(found, depth=depth)


def regions(smooth: Mask) -> NDArray[np.int32]:
    """Return the number of each smooth pixel's region [H, W], from 1; 0 where there is none.

    Regions begin where borders are far, and grow while narrower and narrower gaps in borders let them pass: two that
    only a gap joins have grown by then. It is a watershed of the distance to borders.
    Source: Meyer and Beucher, "Morphological segmentation", 1990.
    """
    inner = cv2.distanceTransform(smooth.astype(np.uint8), cv2.DIST_L2, 5)
    labels = np.zeros(smooth.shape, np.float32)
    for closed in CLOSED_PX:
        labels = _grown(labels, inner > closed, GROWTH_PX)
        free = (inner > closed) & (labels == 0)
        _, parts, boxes, _ = cv2.connectedComponentsWithStats(free.astype(np.uint8), connectivity=4)
        fresh = boxes[:, cv2.CC_STAT_AREA] >= LEAST_PIXELS
        fresh[0] = False
        fresh[np.unique(parts[free & (cv2.dilate(labels, AROUND) > 0)])] = False
        labels = np.where(fresh[parts], labels.max(initial=0) + np.cumsum(fresh)[parts], labels).astype(np.float32)
    return _grown(labels, smooth, CLOSED_PX[0]).astype(np.int32)


def _grown(labels: Image, where: Mask, steps: int) -> Image:
    """Return labels [H, W] after so many steps of a pixel into what has none, `where` a mask is true."""
    for _ in range(steps):
        labels = np.where(where & (labels == 0), cv2.dilate(labels, AROUND), labels)
    return labels


def _boxes(labels: NDArray[np.int32]) -> Iterator[tuple[int, tuple[slice, slice]]]:
    """Yield the number of each region [H, W], with the rows and columns of it and of its reach around it."""
    rows, columns = np.nonzero(labels)
    numbers = labels[rows, columns]
    order = np.argsort(numbers, kind="stable")
    found, first = np.unique(numbers[order], return_index=True)
    ends = [f.reduceat(a[order], first) for a in (rows, columns) for f in (np.minimum, np.maximum)]
    for label, top, bottom, left, right in zip(found.tolist(), *(end.tolist() for end in ends), strict=True):
        down = slice(max(top - REACH_PX, 0), bottom + 1 + REACH_PX)
        yield label, (down, slice(max(left - REACH_PX, 0), right + 1 + REACH_PX))


def _places(rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Floats:
    """Return column, row and 1 of n pixels [n, 3], in pixels over 100: numbers about 1."""
    return np.stack([columns / 100, rows / 100, np.ones(len(rows))], axis=1)


def _plane_of(region: Mask, depth: Image, step: float, rng: np.random.Generator) -> Floats | None:
    """Return the plane [3] of a region as inverse depth over `_places`, None where the border does not tell."""
    size = 2 * REACH_PX + 1
    near = cv2.dilate(region.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    rows, columns = np.nonzero(near & np.isfinite(depth))
    every = max(1, -(-len(rows) // MOST_BORDER))
    rows, columns = rows[::every], columns[::every]
    if len(rows) < LEAST_BORDER:
        return None
    places, inverse = _places(rows, columns), 1 / depth[rows, columns].astype(np.float64)
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
