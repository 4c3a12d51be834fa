"""Light that changes with time or place."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import AcquisitionError
from acquisition.scenes.motion import Vector


@dataclass(frozen=True)
class Flicker:
    """Light that falls and rises `rate_hz` times a second by a raised cosine, at its least by the share `depth`."""

    rate_hz: float
    depth: float
    phase_rad: float = 0.0

    def __post_init__(self) -> None:
        if not self.rate_hz > 0 or not 0 <= self.depth <= 1:
            raise AcquisitionError(f"found flicker of {self.rate_hz} Hz by {self.depth}", "> 0 Hz by 0..1")

    def gains(self, instants_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the light at `instants_s` [n] as a share of the brightest [n]."""
        turns = 2 * np.pi * self.rate_hz * np.asarray(instants_s, dtype=np.float64)
        return 1 - self.depth * (1 - np.cos(turns + self.phase_rad)) / 2


@dataclass(frozen=True)
class Uneven:
    """Light that differs from place to place: `slope` . x + `offset` of all there is, kept between `least` and 1."""

    slope: Vector  # per metre
    offset: float = 1.0
    least: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.least <= 1:
            raise AcquisitionError(f"found a least light of {self.least}", "0..1")


EVEN = Uneven((0.0, 0.0, 0.0))
