"""Backgrounds beyond the usual depths: hills, a horizon, an even sky, nothing at all.

Depths are searched up to four times the object's distance (`sweep.depth_range_m`). What lies beyond matches nowhere in
that range, and its pixels would take the depth of things before them. So one view is swept at a lower resolution
through all depths up to infinity first; where enough of it matches best beyond the usual range, all views are.
An even sky matches at any depth. In a scene that is known to be open, bright even areas at the border of a view are put
on a far shell. Areas without light get no points, and training keeps them empty.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.sensor import DARK_LEVEL
from reconstruction.images.composite import shrunk
from reconstruction.initialization.sweep import DepthMap, Image, SweepOptions, neighbours, sweep_view
from rigs.camera import Camera

PROBE_SCALE, PROBE_PX = 4, 100  # most by which the view that is looked at first is shrunk, and its least width
FARTHEST = 60.0  # usual far depths up to which is searched; a hypothesis step from infinity
SHELL = 4.0  # usual far depths at which an even sky is put, at least
OPEN_SHARE = 0.004  # share of a view beyond the usual depths, from which a scene is open
SURE_COST = 0.35  # matching cost (1 - ZNCC) of a depth that counts
BETTER = 0.05  # by which the cost of a depth beyond must be below the best of the usual ones
EVEN = 0.1  # standard deviation of a sky's light, as a share of it
LEAST_PX = 200  # connected pixels of a sky, or of nothing
DARK = 0.01  # light of an empty area, as a share of white, beside the dark current
WINDOW_PX = 4  # how far from an edge a window of the sweep still sees it, and a pixel more
LEAST_WHITE = 20 * DARK_LEVEL  # spikes per tick
Mask = NDArray[np.bool_]


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
    shrink = max(1, min(PROBE_SCALE, cameras[0].width // PROBE_PX))
    small = [c.scaled(max(1, c.width // shrink), max(1, c.height // shrink)) for c in cameras]
    near = [j + 1 for j in neighbours(small[0], small[1:])]
    views = [(small[i], shrunk(images[i], small[i])) for i in (0, *near)]
    coarse = replace(usual, planes=max(2, usual.planes // 2))
    within, anywhere = (sweep_view(views[0], views[1:], options) for options in (coarse, endless(coarse)))
    beyond = (anywhere.depth > usual.far_m) & (anywhere.cost < SURE_COST) & (anywhere.cost < within.cost - BETTER)
    return float(beyond.mean())


def with_sky(
    maps: Sequence[DepthMap], images: Sequence[Image], textured: Sequence[Mask], usual: SweepOptions
) -> tuple[list[DepthMap], list[Mask]]:
    """Return the maps with a far shell in each view's sky, and the pixels [H, W] that are textured or sky.

    The shell is as far as most that is known, at least SHELL usual far depths.
    """
    skies = [sky(image, mask) for image, mask in zip(images, textured, strict=True)]
    known = np.concatenate([m.depth[mask & np.isfinite(m.depth)] for m, mask in zip(maps, textured, strict=True)])
    shell_m = max(SHELL * usual.far_m, float(np.quantile(known, 0.99)) if len(known) else 0.0)
    there = [replace(m, depth=np.where(s, np.float32(shell_m), m.depth)) for m, s in zip(maps, skies, strict=True)]
    return there, [mask | s for mask, s in zip(textured, skies, strict=True)]


def sky(image: Image, textured: Mask) -> Mask:
    """Return the large bright even areas [H, W] at the border of an image that have no texture."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~textured).astype(np.uint8), connectivity=4)
    found, labels = np.zeros(image.shape, bool), np.asarray(labels)
    border = set(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]).tolist())
    usual = float(np.median(image))
    for label in border - {0}:
        area = labels == label if stats[label, cv2.CC_STAT_AREA] >= LEAST_PX else None
        if area is not None and image[area].mean() > usual and image[area].std() < EVEN * image[area].mean():
            found |= area
    return found


def empty(image: Image, textured: Mask, white: float) -> Mask:
    """Return the large areas [H, W] without texture or light, up to what they surround: nothing is there.

    None are told in a very dim scene.
    """
    dark = (image < DARK * white + DARK_LEVEL) & (white >= LEAST_WHITE)
    _, labels, stats, _ = cv2.connectedComponentsWithStats((dark & ~textured).astype(np.uint8), connectivity=4)
    large = np.asarray(stats)[:, cv2.CC_STAT_AREA] >= LEAST_PX
    large[0] = False
    inside = large[np.asarray(labels, dtype=np.intp)].astype(np.uint8)
    return dark & (cv2.dilate(inside, np.ones((2 * WINDOW_PX + 1,) * 2, np.uint8)) > 0)
