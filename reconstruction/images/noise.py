"""The error that quantisation and shot noise leave in an image: one standard deviation in spikes per tick.

Letters: r light in spikes per tick, n planes of a window, T ticks of an interval, E electrons to a spike.
An error that is uniform over one unit has variance 1/12; the difference of two such, which both a count and an interval
have at their ends, 1/6. Shot noise adds r / (E n) to the variance. `tests/unit/reconstruction/test_methods.py` holds
the formulas against the simulated sensor.
"""

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.sensor import ELECTRONS_PER_SPIKE

Image = NDArray[np.float32]
_ENDS = 1 / 6
PIXEL_SPREAD = 0.01  # of gain and threshold together, from pixel to pixel, after a flat-field correction
SQUARE = 16  # pixels a side that noise is measured in
SMOOTHEST = 0.2  # share of the brighter squares that are taken to have no texture
NORMAL_MEDIAN = 0.6745  # median distance of normal numbers from their mean, in standard deviations


def interval_sigma(ticks: NDArray[np.integer]) -> Image:
    """Return the deviation of 1 / T from an interval of T whole ticks: d(1/T) = dT / T^2, and one spike's electrons."""
    lengths = np.arange(int(ticks.max(initial=1)) + 1)
    squared = np.square(np.maximum(lengths, 1).astype(np.float32))
    return np.sqrt(np.float32(_ENDS) / np.square(squared) + np.float32(1 / ELECTRONS_PER_SPIKE) / squared)[ticks]


def window_sigma(rate: Image, planes: NDArray | int) -> Image:
    """Return the deviation of a mean over n planes: a spike more or less at the ends."""
    n = np.maximum(planes, 1).astype(np.float32)
    return np.sqrt(np.float32(_ENDS) / np.square(n) + _shot(rate) / n)


def interpolated_sigma(rate: Image, ticks: NDArray[np.integer], planes: int) -> Image:
    """Return the deviation of an interpolated count over n planes whose ends lie in intervals of at most T ticks.

    Each end lies evenly between two spikes whose places are uniform in their ticks: r^2 / 18. An interval that holds
    both ends is the whole error, as in `interval_sigma`.
    """
    span = np.maximum(ticks, planes).astype(np.float32)
    ends = np.minimum(np.square(rate) / (9 * planes**2), np.square(np.square(rate)) * np.float32(_ENDS))
    bound = np.float32(_ENDS) / np.square(span)  # of a window without a spike: at most one
    return np.sqrt(np.where(rate * span < 1, bound, ends) + _shot(rate) / span)


def still_sigma(rate: Image, planes: NDArray | int, still: NDArray[np.bool_]) -> Image:
    """Return the deviation between neighbours of a mean over n planes: that of the window, and pixels that differ."""
    spread = max(PIXEL_SPREAD, pixel_spread(rate, planes, still))
    return np.sqrt(np.square(window_sigma(rate, planes)) + np.square(np.float32(spread) * rate))


def pixel_spread(rate: Image, planes: NDArray | int, still: NDArray[np.bool_]) -> float:
    """Return by how much, as a share, `still` pixels differ from their neighbours where a mean is smoothest.

    It is the deviation of the gains where a fifth of the brighter squares have no texture, and more where all have.
    0 for a picture of less than one square, without light or still pixels. Differences cancel slopes.
    Source: Immerkaer, "Fast noise variance estimation", CVIU 1996.
    """
    height, width = ((side - 1) // SQUARE * SQUARE for side in rate.shape)
    if not height or not width:
        return 0.0
    crossed = rate[:-1, :-1] - rate[1:, :-1] - rate[:-1, 1:] + rate[1:, 1:]  # of four pixels: twice their deviation
    chance = np.square(window_sigma(rate, planes))

    def squares(image: NDArray) -> NDArray:
        cut = image[:height, :width].reshape(height // SQUARE, SQUARE, width // SQUARE, SQUARE)
        return cut.transpose(0, 2, 1, 3).reshape(-1, SQUARE * SQUARE)

    noise, light = np.median(squares(np.abs(crossed) / 2), axis=1) / NORMAL_MEDIAN, np.median(squares(rate), axis=1)
    quiet = squares(still).all(axis=1) & (light > 0)
    bright = quiet & (light >= np.median(light[quiet])) if quiet.any() else quiet
    if not bright.any():
        return 0.0
    gains = np.square(noise) - np.median(squares(chance), axis=1)
    return float(np.quantile(np.sqrt(np.maximum(gains, 0))[bright] / light[bright], SMOOTHEST))


def slope_sigma(rate: Image, planes: NDArray | int) -> Image:
    """Return the deviation of the slope over n planes, whose weights w(t) = 6 t (n - t) / n^3 sum the spikes.

    The spike train's own line at q = min(r, 1 - r) leaks through the kinks of w at the ends: variance 0.1 / (q n^2)^2
    (Poisson summation). Where q n is small, one spike or gap anywhere in the window is the whole error: 1.2 q / n. A
    spike's place within its tick adds r (1 - r) / n^3, shot noise 1.2 r / (E n). A window without a spike, or without
    a gap, is taken for the worst q that would leave it so: 0.44 / n.
    """
    n = np.maximum(planes, 1).astype(np.float32)
    r = np.clip(rate, 0, 1)
    rarer = np.maximum(np.minimum(r, 1 - r), np.float32(0.44) / n)
    ends = np.minimum(np.float32(0.1) / np.square(rarer * n * n), np.float32(1.2) * rarer / n)
    return np.sqrt(ends + r * (1 - r) / n**3 + np.float32(1.2) * _shot(rate) / n)


def _shot(rate: Image) -> Image:
    return np.maximum(rate, 0) * np.float32(1 / ELECTRONS_PER_SPIKE)
