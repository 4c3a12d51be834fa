"""TFP, texture from playback: the mean of the planes around an instant.

Order: unbiased while light and scene stand still; the error falls with the window (quantisation 1/window) until motion
blurs it. Use it where nothing moves. Not a count over the past only: the window is centred on the instant.
Source: Zhu et al., "A retina-inspired sampling method for visual texture reconstruction", ICME 2019.
"""

import numpy as np

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.estimate import Estimate, window_around

HALF_WINDOW = 16


def tfp(stream: SpikeStream, plane: int, half_window: int = HALF_WINDOW) -> Estimate:
    """Image at `plane` from up to 2 * half_window + 1 planes; valid everywhere. Cost: one pass over the window."""
    first, last = window_around(stream, plane, half_window)
    mean = stream.counts(first, last).astype(np.float32) / np.float32(last - first)
    return Estimate(mean, np.ones(mean.shape, dtype=bool))
