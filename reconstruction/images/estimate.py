"""What every spike-to-image method returns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError
from acquisition.spikes.stream import SpikeStream


@dataclass(frozen=True, eq=False)
class Estimate:
    """Linear intensity [H, W] float32 in spikes per tick, always finite; `valid` [H, W] where it is more than a bound."""

    intensity: NDArray[np.float32]
    valid: NDArray[np.bool_]


def window_around(stream: SpikeStream, plane: int, half_window: int) -> tuple[int, int]:
    """Planes [first, last) within `half_window` of `plane`, clipped to the stream; refuses a plane outside it."""
    if not 0 <= plane < len(stream):
        raise BadRecordingError(f"found the instant at plane {plane}, expected one inside 0:{len(stream)}")
    return max(0, plane - half_window), min(len(stream), plane + half_window + 1)
