"""TFI, texture from interspike intervals: one over the interval that holds the instant.

Order: sharp under motion (it looks no further than two spikes) but noisy: an interval is a whole number of ticks. Where
one side has no spike within reach the value is the upper bound that the silence allows, and the pixel is not valid.
Cost: a search outward from the instant over packed bits, as far as the darkest of 512 neighbours needs.
Source: Zhu et al., "A retina-inspired sampling method for visual texture reconstruction", ICME 2019.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.intervals import intervals
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.catalogue import Estimate, ImageMethod
from reconstruction.images.noise import interval_sigma

REACH = 128


def tfi(stream: SpikeStream, plane: int) -> Estimate:
    """Return the image at `plane`: 1 / (first spike after it - last spike by then), up to REACH planes away."""
    return tfi_images(stream, [plane])[0]


def tfi_images(stream: SpikeStream, planes: Sequence[int], *, threads: int = 1) -> list[Estimate]:
    """Return the images at many planes of one stream, in one call to the kernel on `threads` cores."""
    ticks, _, before, after = intervals(stream.packed, stream.layout, planes, REACH, threads=threads)
    valid = before & after
    intensity = np.reciprocal(ticks, dtype=np.float32)
    return [Estimate(intensity[i], valid[i], interval_sigma(ticks[i])) for i in range(len(ticks))]


def tfi_intensities(stream: SpikeStream, planes: Sequence[int]) -> NDArray[np.float32]:
    """Return the intensities alone [N, H, W] in spikes per tick."""
    return np.reciprocal(intervals(stream.packed, stream.layout, planes, REACH).ticks, dtype=np.float32)


METHOD = ImageMethod("tfi", tfi, price_s=0.0012)
