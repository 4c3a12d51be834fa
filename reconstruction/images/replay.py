"""Spikes in the order they came, for methods that keep a state for every pixel."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream

HISTORY = 64  # planes before the instant that are played
AHEAD = 24  # planes behind it in which a pixel may close the interval that holds the instant


class Replay:
    """Plays the planes around an instant; each pixel stops at its first spike after the instant.

    `silence` [H, W]: ticks since the last spike played, or since the first plane of the window; `longest` [H, W]: the
    longest it has been; `intervals` [H, W]: how many whole intervals a pixel has had.
    """

    def __init__(self, stream: SpikeStream, plane: int):
        self._first, _ = stream.around(plane, HISTORY)
        _, last = stream.around(plane, AHEAD)
        self._planes = stream.planes(self._first, last).view(bool)
        self._instant = plane
        shape = self._planes.shape[1:]
        self.silence, self.longest, self.intervals = (np.zeros(shape, dtype=np.int16) for _ in range(3))

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """Return which pixels [H, W] fired in every plane played: how much brighter they are cannot be told."""
        return self.longest <= 1

    def __iter__(self) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.int16]]]:
        """Yield for every tick which pixels close an interval [H, W], and its length in ticks [H, W], 1 or more."""
        seen, playing = np.zeros(self.silence.shape, dtype=bool), np.ones(self.silence.shape, dtype=bool)
        for plane, spikes in enumerate(self._planes, self._first):
            fired = spikes & playing
            self.silence += playing
            np.maximum(self.longest, self.silence, out=self.longest)
            closed = fired & seen
            self.intervals += closed
            yield closed, self.silence
            seen |= fired
            self.silence[fired] = 0
            if plane > self._instant:
                playing &= ~fired
