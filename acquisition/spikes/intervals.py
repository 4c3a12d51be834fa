"""Finds intervals and weighted sums of spikes straight from packed planes, with native kernels.

Letters: T planes, N instants, K kernels, H rows (row 0 at the top), W columns, B bytes of a plane.
"""

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError
from acquisition.native import Address, Kernel
from acquisition.spikes.compact import CompactPlanes
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import PLANES, Bytes, Planes, plane_arguments, without_trailing

FARTHEST = 32766  # planes of reach whose intervals still fit in 16 bits
NEAR = (0, 1, 2, 4, 8, 16, 32, 64, 128)  # planes from an end at which `outermost` looks
_spike_intervals = Kernel(
    "acquisition",
    "spike_intervals",
    *(*PLANES, Address, Address, ctypes.c_int64, ctypes.c_int64, ctypes.c_int32, Address, Address, Address),
)
_weigh_planes = Kernel("acquisition", "weigh_planes", *PLANES, Address, ctypes.c_int64, ctypes.c_int32, Address)


class Intervals(NamedTuple):
    """The interval that holds an instant, of every pixel: from the spike before the instant to the spike after it.

    `ticks` [N, H, W] is its length. `since` [N, H, W] counts the silent planes after its first spike, up to and with
    the instant's own. `before` and `after` [N, H, W] say whether there is such a spike. A side without one counts with
    all the planes searched, so that 1 / ticks is the most light that the silence allows.
    """

    ticks: NDArray[np.uint16]
    since: NDArray[np.uint16]
    before: NDArray[np.bool_]
    after: NDArray[np.bool_]


def intervals(
    packed: Planes,
    layout: PlaneLayout,
    planes: Sequence[int],
    reach: int,
    *,
    wanted: Bytes | None = None,
    threads: int = 1,
) -> Intervals:
    """Find the last spike at or before each of `planes` [N] and the first after it, at most `reach` planes away.

    `packed` [T, B] are the planes searched. `wanted` is a packed plane [B] of the only pixels to look at; elsewhere the
    result is 1 tick or what a neighbour needed. Raises BadRecordingError for an instant outside the planes.
    """
    instants = np.asarray(planes, dtype=np.int64)
    outside = instants[(instants < 0) | (instants >= len(packed))]
    if len(outside):
        raise BadRecordingError(f"found the instant at plane {outside[0]}", f"one inside 0:{len(packed)}")
    if not 1 <= reach <= FARTHEST:
        raise BadRecordingError(f"found a reach of {reach} planes", f"1 to {FARTHEST}")
    if isinstance(packed, CompactPlanes):
        return _intervals_by_block(packed, layout, instants, reach, wanted, threads)
    shape = (len(instants), layout.height, layout.stored_width)
    stored = np.ones(shape, np.uint16), np.zeros(shape, np.uint16), np.zeros(shape, np.uint8)
    work = (np.ascontiguousarray(instants), len(instants), reach, threads)
    _spike_intervals(*plane_arguments(packed, layout), wanted, *work, *stored)
    ticks, since, sides = (without_trailing(out, layout) for out in stored)
    return Intervals(ticks, since, (sides & 1).view(bool), (sides >> 1).view(bool))


def outermost(packed: Planes, layout: PlaneLayout) -> NDArray[np.uint16]:
    """Return a whole interval near the first plane and one near the last, of every pixel [2, H, W], in ticks.

    Only planes at the distances NEAR from an end are looked at, the nearest first; 0 where none lies in an interval.
    """
    lengths = np.zeros((2, layout.height, layout.width), np.uint16)
    away = [distance for distance in NEAR if distance < len(packed)]
    for length, planes in zip(lengths, (away, [len(packed) - 1 - distance for distance in away]), strict=True):
        found = intervals(packed, layout, planes, NEAR[-1])
        for ticks, whole in zip(found.ticks, found.before & found.after, strict=True):
            np.copyto(length, ticks, where=whole & (length == 0))
    return lengths


def _intervals_by_block(
    packed: CompactPlanes, layout: PlaneLayout, instants: NDArray, reach: int, wanted: Bytes | None, threads: int
) -> Intervals:
    """Find as `intervals` does, with the planes in reach of one block's instants decoded at a time."""
    found = Intervals(*(np.empty((len(instants), layout.height, layout.width), t) for t in ("u2", "u2", "?", "?")))
    for block in np.unique(instants // packed.block_planes):
        places = np.flatnonzero(instants // packed.block_planes == block)
        first = max(0, int(instants[places].min()) - reach)
        window = packed[first : int(instants[places].max()) + reach + 1]
        part = intervals(window, layout, (instants[places] - first).tolist(), reach, wanted=wanted, threads=threads)
        for whole, own in zip(found, part, strict=True):
            whole[places] = own
    return found


def weighted_counts(packed: Bytes, layout: PlaneLayout, weights: NDArray, *, threads: int = 1) -> NDArray[np.uint32]:
    """Sum `weights` [K, T] over the spikes of each pixel of `packed` [T, B]; returns [K, H, W].

    Raises BadRecordingError unless every kernel is a row of whole numbers from 0, one a plane, that adds up to less
    than 2^32.
    """
    if weights.ndim != 2 or weights.shape[1] != len(packed) or not np.issubdtype(weights.dtype, np.integer):
        raise BadRecordingError(f"found weights {weights.shape} of {weights.dtype}", f"(K, {len(packed)}) integers")
    if weights.size and (weights.min() < 0 or weights.sum(axis=1, dtype=np.uint64).max() >= 2**32):
        raise BadRecordingError("found weights below 0 or adding up to 2^32 or more", "fewer planes")
    kernels = np.ascontiguousarray(weights, dtype=np.uint32)
    out = np.empty((len(kernels), layout.height, layout.stored_width), dtype=np.uint32)
    _weigh_planes(*plane_arguments(packed, layout), kernels, len(kernels), threads, out)
    return without_trailing(out, layout)
