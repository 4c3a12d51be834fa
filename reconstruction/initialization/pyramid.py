"""Sweeps large pictures from coarse to fine: all depths at a small size, then a few beside what was found.

A picture is halved while it stays large enough. At the smallest size every second hypothesis is tried. Each larger size
tries HYPOTHESES beside the depth that the size before has found, smoothed within its surfaces, in a fraction of the
step; at the rim of a surface also beside the depth behind it. What only the largest size shows, and nothing near it in
depth, is lost.
Letters: H rows, W columns. Cost: a quarter of the whole sweep at 400x250, and less where pictures are larger.
Source: Gu et al., "Cascade cost volume for high-resolution multi-view stereo", CVPR 2020 (narrow ranges from coarse
depth); the bent windows follow Bleyer, Rhemann and Rother, "PatchMatch stereo", BMVC 2011.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.images.composite import shrunk
from reconstruction.initialization.sweep import (
    DepthMap,
    Image,
    SweepOptions,
    consistent,
    neighbours,
    sweep_around,
    sweep_view,
)
from reconstruction.parallel import each
from rigs.camera import Camera

LEAST_PX = 20_000  # pixels of the smallest size
COARSE = 2, 64  # by which hypotheses are fewer at the smallest size, and how many are left at least
FINER = 4, 2  # by which steps are finer than those of the size before: at the second smallest, and from there on
HYPOTHESES = 9  # tried around the depth of the size before
NARROWER_PX = 1  # by which windows are smaller in radius: a wide one sees more that is not its own
SURFACE_STEPS = 3.0  # steps of the size before, within which neighbours are of one surface
SMOOTH_PX, REACH_PX = 4.0, 9  # deviation and width of the smoothing within a surface
EDGE_STEPS = 2.0  # steps of the size before across three pixels, from which there is an edge between surfaces
RIM_PX, BEHIND_STEPS = 2, 1.0  # how near a surface behind must be, and how many steps farther at least, to be tried
COMPARED_PX = 3  # width of the windows in which the two are compared
CONTEXT_PX = 8  # of the smallest size: how far around what is wanted is swept, for windows and smoothing
MOST_SHARE = 0.7  # of a view in rectangles, from which all of it is swept
View = tuple[Camera, Image]
Mask = NDArray[np.bool_]
Box = tuple[slice, slice]  # rows and columns


@dataclass(frozen=True, eq=False)
class Pyramid:
    """One view at each size, the largest first."""

    levels: tuple[View, ...]

    @classmethod
    def of(cls, camera: Camera, image: Image, halvings: int) -> "Pyramid":
        """Return the view and as many halvings of it."""
        levels = [(camera, image)]
        for _ in range(halvings):
            small = camera.scaled(max(1, levels[-1][0].width // 2), max(1, levels[-1][0].height // 2))
            levels.append((small, shrunk(levels[-1][1], small)))
        return cls(tuple(levels))


def halvings(camera: Camera) -> int:
    """Return how often a picture of the camera is halved."""
    count = 0
    while camera.width * camera.height / 4 ** (count + 1) >= LEAST_PX:
        count += 1
    return count


def swept_maps(
    cameras: Sequence[Camera],
    images: Sequence[Image],
    options: SweepOptions,
    wanted: Sequence[Mask] | None = None,
) -> list[DepthMap]:
    """Return the depth of every view against its nearest neighbours, NaN where other views do not confirm it.

    Only what is `wanted` [H, W] of each view, and what is near it, is swept.
    """
    sizes = min(map(halvings, cameras))
    views = list(each(lambda one: Pyramid.of(one[0], one[1], sizes), zip(cameras, images, strict=True)))
    threads = max(1, len(os.sched_getaffinity(0)) // len(cameras))

    def swept(i: int) -> DepthMap:
        others = [j for j in range(len(cameras)) if j != i]
        near = [views[others[j]] for j in neighbours(cameras[i], [cameras[j] for j in others])]
        height, width = images[i].shape
        parts = [np.s_[0:height, 0:width]] if wanted is None else boxes(wanted[i], 2**sizes)
        return _pasted(views[i], near, options, parts, threads)

    return consistent(list(each(swept, range(len(cameras)))), options)


def boxes(wanted: Mask, grid: int) -> list[Box]:
    """Return rectangles of a view [H, W] that hold what is `wanted` and what is near it, none over another.

    They begin at multiples of `grid`. It is one of the whole view where little would be left out.
    """
    (height, width), size = wanted.shape, 2 * CONTEXT_PX * grid + 1
    covered = cv2.dilate(wanted.astype(np.uint8), np.ones((size, size), np.uint8))
    parts, before = [], -1
    while covered.sum() != before:  # until no rectangle touches another
        before, parts = covered.sum(), []
        _, _, stats, _ = cv2.connectedComponentsWithStats(covered, connectivity=8)
        for x, y, across, down, _ in np.asarray(stats)[1:].tolist():
            right, bottom = -(-(x + across) // grid) * grid, -(-(y + down) // grid) * grid
            parts.append(np.s_[y // grid * grid : min(bottom, height), x // grid * grid : min(right, width)])
            covered[parts[-1]] = 1
    return parts if covered.mean() < MOST_SHARE else [np.s_[0:height, 0:width]]


def cut(camera: Camera, box: Box) -> Camera:
    """Return the camera of a rectangle of the view."""
    rows, columns = box
    return replace(
        camera,
        width=columns.stop - columns.start,
        height=rows.stop - rows.start,
        cx=camera.cx - columns.start,
        cy=camera.cy - rows.start,
        pixels=None,
    )


def _pasted(
    view: Pyramid, sources: Sequence[Pyramid], options: SweepOptions, parts: Sequence[Box], threads: int
) -> DepthMap:
    """Return the depth of the `parts` of a view, NaN elsewhere, unchecked."""
    camera, image = view.levels[0]
    depth, cost = np.full(image.shape, np.nan, np.float32), np.ones(image.shape, np.float32)
    for part in parts:
        whole = image[part].shape == image.shape
        own = view if whole else Pyramid.of(cut(camera, part), image[part], len(view.levels) - 1)
        found = sweep_pyramid(own, sources, options, threads=threads)
        depth[part], cost[part] = found.depth, found.cost
    return DepthMap(camera, depth, cost)


def sweep_pyramid(
    reference: Pyramid, sources: Sequence[Pyramid], options: SweepOptions, *, threads: int | None = None
) -> DepthMap:
    """Return the depth of every pixel of the reference view at its largest size, unchecked."""
    seen = [[s.levels[level] for s in sources] for level in range(len(reference.levels))]
    if len(seen) == 1:
        return sweep_view(reference.levels[0], seen[0], options, threads=threads)
    narrow = replace(options, radius_px=max(1, options.radius_px - NARROWER_PX))
    coarse = replace(narrow, planes=max(-(-options.planes // COARSE[0]), min(options.planes, COARSE[1])))
    found = sweep_view(reference.levels[-1], seen[-1], coarse, threads=threads)
    step = float(np.diff(coarse.inverse_depths[:2])[0])
    for number, level in enumerate(range(len(seen) - 2, -1, -1)):
        calm = _calmed(np.asarray(1 / found.depth, np.float32), step)
        around, behind = enlarged(calm, reference.levels[level][0], step)
        step /= FINER[min(number, 1)]
        steps = (np.arange(HYPOTHESES, dtype=np.float64) - HYPOTHESES // 2) * step

        def beside(inverse: Image, level: int = level, steps: NDArray[np.floating] = steps) -> DepthMap:
            return sweep_around(reference.levels[level], seen[level], narrow, inverse, steps, threads=threads)

        found = beside(around)
        hidden = np.isfinite(behind)
        if hidden.any():
            found = _better(found, beside(np.where(hidden, behind, around)), hidden)
    return found


def _better(found: DepthMap, behind: DepthMap, hidden: Mask) -> DepthMap:
    """Return the depths, those of `behind` where `hidden` [H, W] and a small window matches better there."""
    size = (COMPARED_PX, COMPARED_PX)
    better = hidden & (cv2.blur(behind.cost, size) < cv2.blur(found.cost, size))
    depth, cost = (np.where(better, getattr(behind, f), getattr(found, f)) for f in ("depth", "cost"))
    return replace(found, depth=depth, cost=cost)


def _calmed(inverse: Image, step: float) -> Image:
    """Return inverse depths, found among hypotheses a `step` apart, smoothed within surfaces."""
    calm = cv2.medianBlur(inverse, 3)
    return np.asarray(cv2.bilateralFilter(calm, REACH_PX, SURFACE_STEPS * step, SMOOTH_PX), np.float32)


def enlarged(calm: Image, camera: Camera, step: float) -> tuple[Image, Image]:
    """Return inverse depths at the size of `camera`, and those of a surface behind, NaN where none is near.

    They are smooth within a surface and sharp between two, which differ by a few `step` (1/m). Windows
    give the rim of a farther surface the depth of the nearer one.
    """
    around = np.ones((3, 3), np.uint8)
    edge = (cv2.dilate(calm, around) - cv2.erode(calm, around) > EDGE_STEPS * step).astype(np.uint8)
    farthest = cv2.erode(calm, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * RIM_PX + 1,) * 2))
    behind = np.where(calm - farthest > BEHIND_STEPS * step, farthest, np.float32(np.nan))
    size = (camera.width, camera.height)
    smooth = cv2.resize(calm, size, interpolation=cv2.INTER_LINEAR)
    sharp, sharply, hidden = (cv2.resize(a, size, interpolation=cv2.INTER_NEAREST) for a in (calm, edge, behind))
    return np.where(np.asarray(sharply) > 0, sharp, smooth).astype(np.float32), np.asarray(hidden, np.float32)
