"""Readable twin of the kernel that reads pictures between their pixels."""

import numpy as np
from numpy.typing import NDArray

from reconstruction.lenses.resampling import REACH, Reading


def read_between_reference(reading: Reading, picture: NDArray[np.float32]) -> NDArray[np.float64]:
    """Readable twin of the kernel `read_between`: what a reading makes of a picture [h, w], in float64."""
    padded, reach = np.pad(picture, REACH, mode="edge"), np.arange(2 * REACH)
    windows = padded[reading.row[..., None, None] + reach[:, None], reading.column[..., None, None] + reach]
    return np.einsum("hwi,hwij,hwj->hw", reading.down.astype(np.float64), windows, reading.across.astype(np.float64))
