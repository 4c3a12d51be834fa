"""Readable twin of the kernel that lets rows wander and pixels overflow. Letters: n planes, H rows, W columns."""

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.readout import REACH
from acquisition.spikes.sensor import _TICK_STEP, _mix, _normal


def read_out_reference(
    light: NDArray[np.float32], row_keys: NDArray[np.uint64], first_tick: int, jitter: float, blooming: float
) -> NDArray[np.float32]:
    """Do what `read_out` does, bit for bit."""
    reached = np.empty_like(light)
    for t, plane in enumerate(light):
        tick = first_tick + t
        lasts = np.maximum(1 + (_late(row_keys, tick, jitter) - _late(row_keys, tick - 1, jitter)), 0)
        level = np.clip(plane.astype(np.float64), 0, 1e6) * lasts[:, None]
        reached[t] = _bloomed(level, blooming)
    return reached


def _late(keys: NDArray[np.uint64], tick: int, jitter: float) -> NDArray[np.float64]:
    with np.errstate(over="ignore"):
        return jitter * _normal(_mix(keys + np.uint64(tick % 2**64) * _TICK_STEP))


def _bloomed(level: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    over = np.maximum(level - 1, 0)
    for _ in range(REACH if share else 0):
        padded = np.pad(over, 1)
        around = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
        held = np.maximum(level, 1)
        level = level + share * 0.25 * around
        over = np.maximum(level - held, 0)
    return level
