"""A recorded stream as the light of a simulated camera."""

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream


class ReplaySource:
    """The planes of one recorded camera, in order, as they lie in its file."""

    def __init__(self, stream: SpikeStream):
        self.layout = stream.layout
        self._stream = stream
        self._given = 0

    def next_planes(self, count: int) -> NDArray[np.uint8]:
        """Return the next packed planes [n, B], n < count only where the recording ends."""
        last = min(self._given + count, len(self._stream))
        planes = self._stream.window(self._given, last)
        self._given = last
        return planes
