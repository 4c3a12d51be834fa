"""The best statistic for each pixel: everything recorded where nothing moves, a short image where something does."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.methods import Method


@dataclass(frozen=True, eq=False)
class CompositeSource:
    """One camera's target images: `still` [H, W], the mean of the clip, but a short image where `moving` [H, W]."""

    stream: SpikeStream
    still: NDArray[np.float32]
    moving: NDArray[np.bool_]
    method: Method

    def at(self, plane: int) -> NDArray[np.float32]:
        """The image [H, W] at `plane`, spikes per tick."""
        if not self.moving.any():
            return self.still
        image = self.still.copy()
        np.copyto(image, self.method(self.stream, plane).intensity, where=self.moving)
        return image


def long_mean(stream: SpikeStream) -> NDArray[np.float32]:
    """Mean of every plane [H, W], spikes per tick."""
    return stream.counts(0, len(stream)).astype(np.float32) / np.float32(len(stream))
