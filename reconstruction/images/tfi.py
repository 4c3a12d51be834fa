"""TFI, texture from interspike intervals: one over the interval that holds the instant.

Order: sharp under motion (it looks no further than two spikes) but noisy: an interval is a whole number of ticks. Where
one side has no spike within reach the value is the upper bound that the silence allows, and the pixel is not valid.
Source: Zhu et al., "A retina-inspired sampling method for visual texture reconstruction", ICME 2019.
"""

import numpy as np

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.estimate import Estimate, window_around

REACH = 128


def tfi(stream: SpikeStream, plane: int, reach: int = REACH) -> Estimate:
    """Image at `plane`: 1 / (first spike after it - last spike at or before it), searched up to `reach` planes away."""
    first, last = window_around(stream, plane, reach)
    planes = stream.planes(first, last)
    before, after = planes[: plane - first + 1][::-1], planes[plane - first + 1 :]
    back, has_before = _first_spike(before)
    ahead, has_after = _first_spike(after)
    ticks = (back + ahead + 1).astype(np.float32)
    return Estimate(np.reciprocal(ticks), has_before & has_after)


def _first_spike(planes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Planes [T, H, W] -> (silent planes before the first spike, T where none [H, W]; whether there is one [H, W])."""
    if len(planes) == 0:
        return np.zeros(planes.shape[1:], dtype=np.int64), np.zeros(planes.shape[1:], dtype=bool)
    fired = np.asarray(planes.any(axis=0))
    return np.where(fired, planes.argmax(axis=0), len(planes)), fired
