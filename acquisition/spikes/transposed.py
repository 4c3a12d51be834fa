"""Turns planes into the trains of single pixels and back, the form in which spikes compress.

A pixel fires nearly periodically in steady light, so the bits of one pixel over time repeat; those of one plane do not.

Letters: T planes, B bytes of a plane, G = ceil(T / 8) bytes of a train.
"""

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
# Steps that transpose 8x8 bits in a 64-bit word (Warren, Hacker's Delight, 7-3): shift, mask of the bits that move.
_STEPS = (
    (np.uint64(7), np.uint64(0x00AA00AA00AA00AA)),
    (np.uint64(14), np.uint64(0x0000CCCC0000CCCC)),
    (np.uint64(28), np.uint64(0x00000000F0F0F0F0)),
)


def trains_of(planes: Bytes) -> Bytes:
    """Return the train of each stored bit [8 B, G] in planes [T, B]; bit k % 8 of byte k // 8 is that of plane k.

    Bits behind the last plane are zero.
    """
    count, plane_bytes = planes.shape
    groups = -(-count // 8)
    padded = np.zeros((groups * 8, plane_bytes), dtype=np.uint8)
    padded[:count] = planes
    words = np.ascontiguousarray(padded.reshape(groups, 8, plane_bytes).swapaxes(1, 2)).view("<u8")
    _transpose_bits(words)
    return np.ascontiguousarray(words.view(np.uint8).reshape(groups, plane_bytes * 8).T)


def planes_of(trains: Bytes, count: int) -> Bytes:
    """Return the first `count` planes [count, B] of trains [8 B, G]."""
    bits, groups = trains.shape
    words = trains.T.copy(order="C").reshape(groups, bits // 8, 8).view("<u8")
    _transpose_bits(words)
    planes = words.view(np.uint8).reshape(groups, bits // 8, 8).swapaxes(1, 2)
    return np.ascontiguousarray(planes).reshape(groups * 8, bits // 8)[:count]


def _transpose_bits(words: NDArray[np.uint64]) -> None:
    """Exchange rows and columns of the 8x8 bits of each word, in place."""
    moved = np.empty_like(words)
    for shift, mask in _STEPS:
        np.right_shift(words, shift, out=moved)
        moved ^= words
        moved &= mask
        words ^= moved
        moved <<= shift
        words ^= moved
