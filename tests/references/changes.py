"""Readable twins of what finds changes of pixels: the native kernel, and the search for failures by every pixel.

Letters: S spans, H rows, W columns.
"""

import numpy as np
from numpy.typing import NDArray

from reconstruction.images.failures import FOLLOW, JUMP, LEAST_SPANS, RESTLESS, STEADY
from reconstruction.images.response import NEVER


def changed_windows_reference(
    counts: NDArray[np.uint32], gains: NDArray[np.float64], least: float, shot: float
) -> NDArray[np.bool_]:
    """Readable twin of the kernel `changed_windows`, for counts [S, H, W] and gains [S]."""
    steady = counts / gains[:, None, None]
    return np.ptp(steady, axis=0) >= least + np.sqrt(steady.mean(axis=0)) * shot


def failing_pixels_reference(counts: NDArray[np.uint32], gains: NDArray[np.float32], length: int) -> NDArray[np.int32]:
    """Readable twin of `failing_pixels`, from the counts [S, H, W] of spans of `length` planes and their gains [S]."""
    counts = counts.astype(np.float32)
    fails = np.full(counts.shape[1:], NEVER, np.int32)
    for row, column in np.ndindex(*fails.shape):
        own = counts[:, row, column]
        if np.ptp(own) < JUMP or abs(own[-1] - own[-2]) > STEADY:
            continue
        around = np.pad(counts, ((0, 0), (1, 1), (1, 1)), mode="reflect")[:, row : row + 3, column : column + 3]
        others = np.delete(around.reshape(len(counts), 9), 4, axis=1).T
        for number in range(1, len(counts) - LEAST_SPANS + 1):
            if _fails(own, others, gains, number):
                fails[row, column] = (number - 1) * length
                break
    return fails


def _fails(own: NDArray, others: NDArray, gains: NDArray, number: int) -> bool:
    old, new = slice(max(0, number - LEAST_SPANS), number), slice(number + 1, None)

    def jump(counts: NDArray) -> float:
        return abs(np.median(counts[new]) - np.median(counts[old] / gains[old]) * gains[new].mean())

    if np.ptp(own[new]) > STEADY or jump(own) < JUMP:
        return False
    calm = max(map(jump, others)) <= FOLLOW * jump(own)
    restless = min(np.ptp(other[new]) for other in others) >= RESTLESS and own[new].mean() >= JUMP
    silent = own[new].max() == 0 and min(other[new].mean() for other in others) >= JUMP
    return calm or restless or silent
