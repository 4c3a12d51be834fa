"""Readable twins of the native kernels that count spikes and find intervals.

Letters: T planes, N instants, K kernels, H rows (row 0 at the top), W columns, B bytes of a plane.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.intervals import Intervals
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import Bytes, unpack_reference


def counts_reference(packed: Bytes, layout: PlaneLayout) -> NDArray[np.uint32]:
    """Count the spikes of each pixel [H, W] over packed planes [T, B]."""
    return unpack_reference(packed, layout).sum(axis=0, dtype=np.uint32)


def intervals_reference(packed: Bytes, layout: PlaneLayout, planes: Sequence[int], reach: int) -> Intervals:
    """Find the intervals at each of `planes` [N] by unpacking every plane within `reach`."""
    found = []
    for plane in planes:
        first = max(0, plane - reach)
        spikes = unpack_reference(packed[first : plane + reach + 1], layout)
        back, before = _first_spike(spikes[: plane - first + 1][::-1])
        ahead, after = _first_spike(spikes[plane - first + 1 :])
        found.append(((back + ahead + 1).astype(np.uint16), back.astype(np.uint16), before, after))
    return Intervals(*(np.stack(part) for part in zip(*found, strict=True)))


def weighted_counts_reference(packed: Bytes, layout: PlaneLayout, weights: NDArray) -> NDArray[np.uint32]:
    """Sum `weights` [K, T] over the spikes of each pixel; returns [K, H, W]."""
    return np.tensordot(weights.astype(np.uint32), unpack_reference(packed, layout), axes=1).astype(np.uint32)


def _first_spike(planes: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Count the silent planes [T, H, W] before the first spike (T where none), and say whether there is one, [H, W]."""
    if len(planes) == 0:
        return np.zeros(planes.shape[1:], dtype=np.int64), np.zeros(planes.shape[1:], dtype=bool)
    fired = np.asarray(planes.any(axis=0))
    return np.where(fired, planes.argmax(axis=0), len(planes)), fired
