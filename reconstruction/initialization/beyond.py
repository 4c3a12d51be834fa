"""Backgrounds beyond the usual depths: hills, a horizon, an even sky.

Depths are searched up to four times the object's distance (`sweep.depth_range_m`). What lies beyond matches nowhere in
that range, and its pixels would take the depth of things before them. So one view is swept at a lower resolution
through all depths up to infinity first; where enough of it matches best beyond the usual range, all views are.
An even sky matches at any depth. In a scene that is known to be open, plain pixels without a confirmed depth are put
on a far shell; elsewhere they are left to what surrounds them.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.images.composite import shrunk
from reconstruction.initialization.sweep import DepthMap, Image, SweepOptions, neighbours, sweep_view
from rigs.camera import Camera

PROBE_SCALE = 4  # shrinking of the view that is looked at first
FARTHEST = 60.0  # usual far depths up to which is searched; a hypothesis step from infinity
SHELL = 30.0  # usual far depths at which an even sky is put
OPEN_SHARE = 0.004  # share of a view beyond the usual depths, from which a scene is open
SURE_COST = 0.35  # matching cost (1 - ZNCC) of a depth that counts
BETTER = 0.05  # by which the cost of a depth beyond must be below the best of the usual ones
EVEN = 0.1  # standard deviation of a sky's light, as a share of it
LEAST_PX = 200  # connected pixels of a sky


def searched(cameras: Sequence[Camera], images: Sequence[Image], usual: SweepOptions) -> SweepOptions:
    """Return the depths to sweep: the usual ones, or up to infinity where a view shows things beyond them."""
    return endless(usual) if share_beyond(cameras, images, usual) >= OPEN_SHARE else usual


def endless(usual: SweepOptions) -> SweepOptions:
    """Return the same steps of inverse depth, on to nearly zero."""
    far_m = FARTHEST * usual.far_m
    more = (1 / usual.near_m - 1 / far_m) / (1 / usual.near_m - 1 / usual.far_m)
    return replace(usual, far_m=far_m, planes=round((usual.planes - 1) * more) + 1)


def is_open(options: SweepOptions, usual: SweepOptions) -> bool:
    """Return whether depths are searched beyond the usual ones."""
    return options.far_m > usual.far_m


def share_beyond(cameras: Sequence[Camera], images: Sequence[Image], usual: SweepOptions) -> float:
    """Return the share of the first view's pixels that match well beyond the usual depths, and better than within."""
    small = [c.scaled(max(1, c.width // PROBE_SCALE), max(1, c.height // PROBE_SCALE)) for c in cameras]
    near = [j + 1 for j in neighbours(small[0], small[1:])]
    views = [(small[i], shrunk(images[i], small[i])) for i in (0, *near)]
    coarse = replace(usual, planes=max(2, usual.planes // 2))
    within, anywhere = (sweep_view(views[0], views[1:], options) for options in (coarse, endless(coarse)))
    beyond = (anywhere.depth > usual.far_m) & (anywhere.cost < SURE_COST) & (anywhere.cost < within.cost - BETTER)
    return float(beyond.mean())


def with_sky(found: DepthMap, image: Image, textured: NDArray[np.bool_], usual: SweepOptions) -> DepthMap:
    """Return the map with a far shell in large even areas of the `image` [H, W] of unknown depth, not `textured`."""
    unknown = ~textured & ~np.isfinite(found.depth)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(unknown.astype(np.uint8))
    depth = found.depth.copy()
    for label in range(1, count):
        area = np.asarray(labels) == label if stats[label, cv2.CC_STAT_AREA] >= LEAST_PX else None
        if area is not None and image[area].std() < EVEN * image[area].mean():
            depth[area] = SHELL * usual.far_m
    return replace(found, depth=depth)
