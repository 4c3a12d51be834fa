"""Least-squares slope of the cumulative count: a mean whose ends are faded out.

The slope of the line that fits C_0, ..., C_n, the spikes before each of n planes, weighs the spike of plane k with
6 (k + 1) (n - k) / (n (n + 1) (n + 2)): a parabola. A spike that just misses the window then hardly matters, and the
quantisation falls as n^-3/2 where a mean's falls as 1/n. Order: better than TFP wherever light is constant, and less
blurred than TFP of the same n (its weights are 0.77 as wide). Use it where nothing or little moves.
A pixel that never or always fires in the window is not valid: its light is bounded on one side only.
Cost: one pass over the packed window. Source: ordinary least squares; the weights are worked out here.
"""

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.intervals import weighted_counts
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.catalogue import Estimate, ImageMethod
from reconstruction.images.noise import slope_sigma

HALF_WINDOW = 16


def slope(stream: SpikeStream, plane: int, half_window: int = HALF_WINDOW) -> Estimate:
    """Return the image at `plane` from up to 2 * half_window + 1 planes."""
    first, last = stream.around(plane, half_window)
    weights = slope_weights(last - first)
    sums = weighted_counts(stream.window(first, last), stream.layout, weights[None])[0]
    rate = (sums / weights.sum()).astype(np.float32)
    return Estimate(rate, (sums > 0) & (sums < weights.sum()), slope_sigma(rate, last - first))


def slope_weights(planes: int) -> NDArray[np.int64]:
    """Return the weights [T] of T planes' spikes: a sum over spikes, divided by the weights' sum, is the slope."""
    k = np.arange(planes)
    return (k + 1) * (planes - k)


METHOD = ImageMethod("slope", slope, price_s=0.0019)
