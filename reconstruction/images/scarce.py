"""Movers and background where a pixel fires too seldom to be judged alone: counts are pooled over squares of pixels.

Letters: W windows, m spikes of a pixel and window on average. A count of m varies by the rounding to whole spikes, at
most 1/4 and no more than m itself, and by a Fano factor of .05. The counts of a square add up, and so do their
variances: a square of n pixels tells a change of its light that is the square root of n times fainter. What it cannot
tell is where in the square the change is, so the smallest squares that tell anything are the best.
"""

import math
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.flicker import Light

SCARCE = 50.0  # spikes of a pixel in the clip, below which single pixels are not enough
LIT = 0.05  # share of the brightest pixels' spikes, from which a pixel sees light
WINDOWS = (2, 4, 8, 16)  # equal parts of the clip, for slow and for brief change
LEAST_PLANES = 3  # of a window
SQUARES_PX = (3, 5, 9, 15)  # widths of the squares
POOLED = 9.0  # spikes of a square and window, at least
DEVIATIONS = 6.5  # standard deviations beyond which a square has changed; noise alone reached 6.0 in 10^6 squares
BESIDE = 4.5  # standard deviations of a square that is connected with one that has changed
ROUNDING, FANO = 0.25, 0.05  # spikes^2 of variance a pixel, and a spike
CALM, WIDEST_PX = 9.0, 7  # spikes of a square that shows a picture, and its width at most
FEW = 0.5  # spikes^2 of variance of a square, where it hardly ever fires
PARTS = 8  # parts of the clip that a background is made of
STRAY = 3.5  # standard deviations by which a part shows something else
MOSTLY = 0.4  # share of the parts that may show something else

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]


def is_scarce(stream: SpikeStream) -> bool:
    """Return whether the pixels that see light fire too seldom to be judged one by one."""
    return lit_spikes(stream) < SCARCE


def lit_spikes(stream: SpikeStream) -> float:
    """Return the mean number of spikes of the pixels that see light."""
    counts = stream.counts(0, len(stream))
    return float(counts[counts >= LIT * np.percentile(counts, 99)].mean())


def changing(stream: SpikeStream, light: Light) -> Mask:
    """Return the pixels [H, W] around which squares of counts change by more than `light` and noise explain."""
    most = np.zeros((stream.layout.height, stream.layout.width), dtype=np.float32)
    for windows in (w for w in WINDOWS if len(stream) >= LEAST_PLANES * w):
        counts, gains = steady_counts(stream, windows, light)
        mean = counts.mean(axis=0)
        for side in SQUARES_PX:
            if float(mean.mean()) * side**2 >= POOLED:
                most = np.maximum(most, np.max(list(_strays(counts, mean, gains, side)), axis=0))
    _, regions = cv2.connectedComponents((most > BESIDE).astype(np.uint8))
    sure = np.unique(np.asarray(regions)[most > DEVIATIONS])
    return np.isin(regions, sure[sure > 0])


def steady_background(stream: SpikeStream, light: Light) -> tuple[Floats, Mask]:
    """Return the light [H, W] of the parts of the clip that show what most show, and where these are most parts."""
    counts, gains = steady_counts(stream, min(PARTS, len(stream)), light)
    length, mean = len(stream) // min(PARTS, len(stream)), counts.mean(axis=0)
    side = next((s for s in SQUARES_PX if float(mean.mean()) * s**2 >= POOLED), SQUARES_PX[-1])
    kept = np.stack(list(_strays(counts, mean, gains, side, middle=True))) < STRAY
    kept |= ~kept.any(axis=0)
    image = (counts * kept).sum(axis=0) / (kept.sum(axis=0) * np.float32(length))
    return image.astype(np.float32), kept.mean(axis=0) > 1 - MOSTLY


def calm_side(image: Floats, planes: int) -> int:
    """Return the odd width, at most WIDEST_PX, of squares that hold CALM spikes in an image of so many planes."""
    spikes = max(float(image.mean()) * planes, 1e-9)
    return max(1, min(WIDEST_PX, 2 * math.ceil((math.sqrt(CALM / spikes) - 1) / 2) + 1))


def calmed(image: Floats, side: int) -> Floats:
    """Return the image [H, W] averaged over squares `side` px wide."""
    return image if side == 1 else np.asarray(cv2.blur(image, (side, side)), dtype=np.float32)


def steady_counts(stream: SpikeStream, windows: int, light: Light) -> tuple[Floats, Floats]:
    """Return the counts over equal windows [W, H, W] as in steady light, and the gain of each window [W].

    Windows in the dark are left out, where there are others.
    """
    length = len(stream) // windows
    spans = [(i * length, (i + 1) * length) for i in range(windows)]
    spans = light.lit(spans) or spans
    gains = np.array([light.over(*span) for span in spans], dtype=np.float32)
    return np.stack([stream.counts(*s) / gain for s, gain in zip(spans, gains, strict=True)]).astype(np.float32), gains


def _strays(counts: Floats, mean: Floats, gains: Floats, side: int, *, middle: bool = False) -> Iterator[Floats]:
    """Yield how far each window's square [H, W] is from the mean one, or the median one, in deviations."""
    pooled = np.stack([_sum(c, side) for c in counts])
    usual = np.median(pooled, axis=0) if middle else pooled.mean(axis=0)
    deviations: dict[float, Floats] = {}  # by gain: in steady light, there is one
    for square, gain in zip(pooled, gains, strict=True):
        if float(gain) not in deviations:
            variance = _sum(np.minimum(mean * gain, ROUNDING) + FANO * mean * gain, side) / gain**2
            deviations[float(gain)] = np.sqrt(variance + FEW)
        yield (np.abs(square - usual) / deviations[float(gain)]).astype(np.float32)


def _sum(image: Floats, side: int) -> Floats:
    total = cv2.boxFilter(image, -1, (side, side), normalize=False, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(total, dtype=np.float32)
