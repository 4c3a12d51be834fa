"""TFP, texture from playback: the mean of the planes around an instant.

Order: unbiased while light and scene stand still; the error falls with the window (quantisation 1/window) until motion
blurs it. Use it where nothing moves. Not a count over the past only: the window is centred on the instant.
A pixel that never or always fires in the window is not valid: its light is bounded on one side only.
Cost: one pass over the packed window.
Source: Zhu et al., "A retina-inspired sampling method for visual texture reconstruction", ICME 2019.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.packing import window_means
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.catalogue import Estimate, ImageMethod
from reconstruction.images.noise import window_sigma

HALF_WINDOW = 16


def tfp(stream: SpikeStream, plane: int) -> Estimate:
    """Return the image at `plane` from up to 2 * HALF_WINDOW + 1 planes."""
    first, last = stream.around(plane, HALF_WINDOW)
    mean = tfp_intensities(stream, [plane])[0]
    return Estimate(mean, (mean > 0) & (mean < 1), window_sigma(mean, last - first))


def tfp_intensities(stream: SpikeStream, planes: Sequence[int], *, threads: int = 1) -> NDArray[np.float32]:
    """Return the intensities alone [N, H, W] in spikes per tick."""
    bounds = np.array([stream.around(plane, HALF_WINDOW) for plane in planes]).reshape(-1, 2)
    return window_means(stream.packed, stream.layout, bounds, threads=threads)


METHOD = ImageMethod("tfp", tfp, price_s=0.0005)
