"""Intervals and weighted sums of spikes, straight from packed planes: native kernels and their readable twins.

Letters: T planes, N instants, K kernels, H rows (row 0 at the top), W columns, B bytes of a plane.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError
from acquisition.native import load_library
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import Bytes, native_arguments, pointer, unpack_reference

FARTHEST = 32766  # planes of reach whose intervals still fit in 16 bits


class Intervals(NamedTuple):
    """The interval that holds an instant: `ticks` [N, H, W] from the spike before it to the spike after it.

    `since` [N, H, W]: silent planes up to and with the instant's since the spike before it. `before` and `after`
    [N, H, W]: there is such a spike. A side without one counts with all the planes searched, so that 1 / ticks is the
    most light that the silence allows.
    """

    ticks: NDArray[np.uint16]
    since: NDArray[np.uint16]
    before: NDArray[np.bool_]
    after: NDArray[np.bool_]


def intervals(
    packed: Bytes,
    layout: PlaneLayout,
    planes: Sequence[int],
    reach: int,
    *,
    wanted: Bytes | None = None,
    threads: int = 1,
) -> Intervals:
    """The last spike at or before each of `planes` [N] to the first after it, at most `reach` planes away.

    Native twin of `intervals_reference`. `wanted` is a packed plane [B] of the only pixels to look at; elsewhere the
    result is 1 tick or what a neighbour needed. Raises BadRecordingError for a plane outside the planes [T, B].
    """
    instants = _checked(packed, planes, reach)
    shape = (len(instants), layout.height, layout.stored_width)
    ticks, since, sides = np.ones(shape, np.uint16), np.zeros(shape, np.uint16), np.zeros(shape, np.uint8)
    work = (pointer(instants), *(ctypes.c_int64(n) for n in (len(instants), reach)), ctypes.c_int32(threads))
    load_library("acquisition").spike_intervals(
        *native_arguments(packed, layout),
        None if wanted is None else pointer(wanted),
        *work,
        *(pointer(out) for out in (ticks, since, sides)),
    )
    ticks, since, sides = (np.ascontiguousarray(out[:, :, : layout.width]) for out in (ticks, since, sides))
    return Intervals(ticks, since, (sides & 1).view(bool), (sides >> 1).view(bool))


def intervals_reference(packed: Bytes, layout: PlaneLayout, planes: Sequence[int], reach: int) -> Intervals:
    """The readable twin of `intervals`: unpacks every plane within reach, in NumPy."""
    found = []
    for plane in _checked(packed, planes, reach):
        first = max(0, plane - reach)
        spikes = unpack_reference(packed[first : plane + reach + 1], layout)
        back, before = _first_spike(spikes[: plane - first + 1][::-1])
        ahead, after = _first_spike(spikes[plane - first + 1 :])
        found.append(((back + ahead + 1).astype(np.uint16), back.astype(np.uint16), before, after))
    return Intervals(*(np.stack(part) for part in zip(*found, strict=True)))


def weighted_counts(packed: Bytes, layout: PlaneLayout, weights: NDArray, *, threads: int = 1) -> NDArray[np.uint32]:
    """Sums of weights [K, T] over the spikes of each pixel [K, H, W]; native twin of `weighted_counts_reference`.

    Raises BadRecordingError unless every kernel is a row of whole numbers from 0, one a plane, that adds up to less
    than 2^32.
    """
    kernels = _checked_weights(weights, len(packed))
    out = np.empty((len(kernels), layout.height, layout.stored_width), dtype=np.uint32)
    work = (pointer(kernels), ctypes.c_int64(len(kernels)), ctypes.c_int32(threads))
    load_library("acquisition").weigh_planes(*native_arguments(packed, layout), *work, pointer(out))
    return np.ascontiguousarray(out[:, :, : layout.width])


def weighted_counts_reference(packed: Bytes, layout: PlaneLayout, weights: NDArray) -> NDArray[np.uint32]:
    """The readable twin of `weighted_counts`, in NumPy."""
    sums = np.tensordot(_checked_weights(weights, len(packed)), unpack_reference(packed, layout), axes=1)
    return sums.astype(np.uint32)


def _first_spike(planes: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Planes [T, H, W] -> silent planes before the first spike (T where none) and whether there is one, [H, W]."""
    if len(planes) == 0:
        return np.zeros(planes.shape[1:], dtype=np.int64), np.zeros(planes.shape[1:], dtype=bool)
    fired = np.asarray(planes.any(axis=0))
    return np.where(fired, planes.argmax(axis=0), len(planes)), fired


def _checked(packed: Bytes, planes: Sequence[int], reach: int) -> NDArray[np.int64]:
    instants = np.asarray(planes, dtype=np.int64)
    outside = instants[(instants < 0) | (instants >= len(packed))]
    if len(outside):
        raise BadRecordingError(f"found the instant at plane {outside[0]}", f"one inside 0:{len(packed)}")
    if not 1 <= reach <= FARTHEST:
        raise BadRecordingError(f"found a reach of {reach} planes", f"1 to {FARTHEST}")
    return np.ascontiguousarray(instants)


def _checked_weights(weights: NDArray, planes: int) -> NDArray[np.uint32]:
    if weights.ndim != 2 or weights.shape[1] != planes or not np.issubdtype(weights.dtype, np.integer):
        raise BadRecordingError(f"found weights {weights.shape} of {weights.dtype}", f"(K, {planes}) integers")
    if weights.size and (weights.min() < 0 or weights.sum(axis=1, dtype=np.uint64).max() >= 2**32):
        raise BadRecordingError("found weights below 0 or adding up to 2^32 or more", "fewer planes")
    return np.ascontiguousarray(weights, dtype=np.uint32)
