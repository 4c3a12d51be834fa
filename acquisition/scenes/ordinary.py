"""Simulates an ordinary camera beside a spike camera: long exposures, one after another, and a sensor's noise."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError

READOUT_PLANES = 1  # spike planes between the end of an exposure and the next


class Exposure(NamedTuple):
    """The planes of one frame: `planes`, an odd number, from `first` on."""

    first: int
    planes: int

    @property
    def middle(self) -> int:
        """The plane whose instant is the middle of the exposure."""
        return self.first + self.planes // 2


@dataclass(frozen=True)
class OrdinaryCamera:
    """A machine-vision camera with a global shutter, which exposes all the time; its light is set so that white fits.

    The rate is the highest of common ones, 60 to 200 Hz: the least blur. Well, noise and bits are those that makers
    state by EMVA 1288 for sensors with pixels of 3.45 um. `white_share` is the share of the well that white light
    fills in one exposure.
    """

    rate_hz: float = 200.0
    full_well_e: float = 10_000.0
    read_noise_e: float = 2.5
    bits: int = 12
    white_share: float = 0.8

    def exposures(self, tick_rate_hz: float, ticks: int, most: int | None = None) -> list[Exposure]:
        """Return the whole exposures of a clip of so many ticks; none where planes or clip are too few for one.

        Where they are more than `most`, no more than these are returned, evenly.
        """
        count, period = self.exposure_ticks(tick_rate_hz), round(tick_rate_hz / self.rate_hz)
        firsts = range(0, ticks - count + 1, period) if count else range(0)
        every = 1 if most is None else max(1, -(-len(firsts) // most))
        return [Exposure(first, count) for first in firsts[::every]]

    def exposure_ticks(self, tick_rate_hz: float) -> int:
        """Return the ticks of an exposure, an odd number so that one is the middle; 0 where they are too few."""
        count = round(tick_rate_hz / self.rate_hz) - READOUT_PLANES
        return max(0, count - 1 + count % 2)

    def read(self, light: NDArray[np.float32], white: float, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return the frame [H, W] that the mean light [H, W] of an exposure makes, in the same units.

        The pixels saturate at the full well. Light and its black level are what a calibrated camera tells, so values
        below zero occur in the dark. Raises BadRecordingError for light or a white that is not finite, or no white.
        """
        if not (np.isfinite(light).all() and 0 < white < np.inf):
            raise BadRecordingError(f"found light that is not finite or a white of {white:g}", "finite light above 0")
        electrons_a_light = self.white_share * self.full_well_e / white
        mean = np.clip(light.astype(np.float64) * electrons_a_light, 0, self.full_well_e)
        electrons = rng.poisson(mean) + self.read_noise_e * rng.standard_normal(light.shape)
        step = self.full_well_e / (2**self.bits - 1)
        black = np.floor(4 * self.read_noise_e / step)  # levels kept for noise below zero
        levels = np.clip(np.round(electrons / step), -black, 2**self.bits - 1 - black)
        return (levels * step / electrons_a_light).astype(np.float32)

    def description(self, tick_rate_hz: float) -> dict[str, float | int]:
        """Return what `truth/scene.json` says of the camera."""
        return asdict(self) | {"exposure_ticks": self.exposure_ticks(tick_rate_hz)}
