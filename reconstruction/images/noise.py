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
PIXEL_SPREAD = 0.01  # of gain and threshold together, from pixel to pixel


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


def still_sigma(rate: Image, planes: int) -> Image:
    """Return the deviation between neighbours of a mean over n planes: that of the window, and pixels that differ."""
    return np.sqrt(np.square(window_sigma(rate, planes)) + np.square(np.float32(PIXEL_SPREAD) * rate))


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
