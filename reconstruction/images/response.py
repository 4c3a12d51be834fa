"""The answer of a camera's pixels to light, and the light that a measured rate stands for.

A pixel fires gain * light + offset spikes per tick until it fails. Maps of gain and offset come from a calibration
(`images.pixels`) or from an estimate; failures are found in the recording. Letters: H rows, W columns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from reconstruction.images.mending import mended
from reconstruction.images.pixels import PixelCalibration

NEVER = int(np.iinfo(np.int32).max)  # the plane at which a good pixel fails
LEAST_GAIN, MOST_GAIN = 0.1, 10.0  # beyond these a pixel is of no use: its noise is all that is left

Image = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Response:
    """Maps [H, W] of one camera: `gain`, `offset` in spikes per tick, both float32, and `fails`.

    `fails` (int32) is the plane from which a pixel is of no use: 0 for one that never was of any, NEVER for a good one.
    """

    gain: Image
    offset: Image
    fails: NDArray[np.int32]

    @classmethod
    def even(cls, shape: tuple[int, int]) -> Response:
        """Return the response of pixels that are all alike and good."""
        return cls(np.ones(shape, np.float32), np.zeros(shape, np.float32), np.full(shape, NEVER, np.int32))

    @classmethod
    def calibrated(cls, maps: PixelCalibration) -> Response:
        """Return the response that a calibration has found; what it holds for hot or dead is of no use."""
        bad = maps.defect | (maps.gain < LEAST_GAIN) | (maps.gain > MOST_GAIN)
        gain = np.where(bad, np.float32(1), maps.gain)
        offset = np.where(bad, np.float32(0), maps.offset)
        return cls(gain, offset, np.where(bad, 0, NEVER).astype(np.int32))

    @cached_property
    def uneven(self) -> bool:
        """A flag: gains or offsets change something."""
        return bool((self.gain != 1).any() or (self.offset != 0).any())

    def useless(self, last: int) -> NDArray[np.bool_]:
        """Return which pixels [H, W] are of no use in planes before `last`."""
        return self.fails < last

    def light(self, rate: Image) -> Image:
        """Return the light [H, W] behind a rate [H, W], both in spikes per tick; never negative."""
        return np.maximum((rate - self.offset) / self.gain, 0) if self.uneven else rate

    def seen(self, light: Image) -> Image:
        """Return the rate [H, W] that light [H, W] makes, both in spikes per tick."""
        return light * self.gain + self.offset

    def mended(self, rate: Image, last: int) -> Image:
        """Return the light [H, W] behind the rate over some planes before `last`, useless pixels filled in."""
        return mended(self.light(rate), self.useless(last))

    def times(self, factors: Image | float) -> Response:
        """Return the response with its gains times `factors`."""
        return replace(self, gain=(self.gain * factors).astype(np.float32))

    def since(self, plane: int) -> Response:
        """Return the response on a clock that begins at `plane`."""
        later = np.where(self.fails == NEVER, NEVER, np.maximum(self.fails - plane, 0))
        return replace(self, fails=later.astype(np.int32))

    def failing(self, fails: NDArray[np.int32]) -> Response:
        """Return the response of pixels that fail at the planes `fails` [H, W], or before where this one says so."""
        return replace(self, fails=np.minimum(self.fails, fails))
