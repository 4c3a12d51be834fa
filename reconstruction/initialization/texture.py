"""Tells which pixels have a texture that determines their depth, and what follows for poses and for points.

Wrong poses leave depths unconfirmed that texture determines. A plain wall confirms nothing and says nothing. It needs
few Gaussians, too: more of them learn its noise.
Letters: H rows, W columns.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import StereoError
from reconstruction.initialization.sweep import DepthMap, Image, SweepOptions

TEXTURED = 2.0  # deviations of an image's noise that a window spreads by, from which its depth can be judged
LEAST_TEXTURE = 0.005  # share of textured pixels from which poses can be judged
LEAST_SHARE = 0.4  # of textured pixels with a confirmed depth; right poses leave 0.65 to 0.91, wrong ones 0.07 to 0.2
PLAIN_SHARE = 0.125  # share of the pixels without texture that points may be drawn from
PIXELS_EACH = 2.5  # pixels of a view that are left, for each point of a plain scene

Mask = NDArray[np.bool_]


def spread_of(image: Image, radius: int, *, sloping: bool = True) -> Image:
    """Return the standard deviation [H, W] of the windows of `radius` around each pixel.

    Without `sloping`, the window's mean slope is taken out: a slope is alike wherever one cuts it and tells no depth.
    """
    size = (2 * radius + 1, 2 * radius + 1)
    exact = image.astype(np.float64)
    mean = cv2.blur(exact, size)
    variance = cv2.blur(exact * exact, size) - mean * mean
    if not sloping:
        offsets = np.arange(-radius, radius + 1, dtype=np.float64)
        even = np.full(len(offsets), 1 / len(offsets))
        for kernels in ((offsets * even, even), (even, offsets * even)):
            variance -= np.square(cv2.sepFilter2D(exact, cv2.CV_64F, *kernels)) / np.mean(np.square(offsets))
    return np.sqrt(np.maximum(variance, 0)).astype(np.float32)


def textured(image: Image, noise: Image, options: SweepOptions) -> Mask:
    """Return which pixels [H, W] have a window that spreads by more than its slope and the `noise` [H, W] of pixels."""
    return spread_of(image, options.radius_px, sloping=False) > TEXTURED * noise


def judge_poses(maps: Sequence[DepthMap], sure: Sequence[Mask]) -> str:
    """Return in words how many of the textured pixels `sure` [H, W] have a depth that other views confirm.

    Raises StereoError where they are too few for right poses, or where too little texture is there to tell.
    """
    texture = float(np.mean([mask.mean() for mask in sure]))
    if texture < LEAST_TEXTURE:
        raise StereoError(
            f"found texture in {texture:.2%} of the pixels", f"{LEAST_TEXTURE:.1%}", "give the scene light or texture"
        )
    confirmed = sum(int((np.isfinite(m.depth) & mask).sum()) for m, mask in zip(maps, sure, strict=True))
    share = confirmed / sum(int(mask.sum()) for mask in sure)
    if share < LEAST_SHARE:
        raise StereoError(
            f"found a confirmed depth in {share:.1%} of the pixels with texture",
            f"{LEAST_SHARE:.0%}",
            "check the poses; those of a drawing are found from the scene by --init natural",
        )
    return f"{texture:.0%} of the pixels have texture, {share:.0%} of them a depth that two views confirm"


def thinned(
    wanted: Sequence[Mask], sure: Sequence[Mask], most: int, rng: np.random.Generator
) -> tuple[list[Mask], int]:
    """Return the `wanted` pixels [H, W] of each view that points are drawn from, and how many points: at most `most`.

    `sure` pixels have texture, and all of them stay; of the others PLAIN_SHARE does. The number of points falls as that
    of the pixels does, so that textured ones get no fewer, unless one for every PIXELS_EACH of a view is more.
    """
    kept = [mask & (has | (rng.random(mask.shape) < PLAIN_SHARE)) for mask, has in zip(wanted, sure, strict=True)]
    left, whole = (sum(int(mask.sum()) for mask in masks) for masks in (kept, wanted))
    needed = max(left / len(kept) / PIXELS_EACH, most * left / max(whole, 1))
    return kept, min(most, round(needed))
