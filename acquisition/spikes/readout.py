"""Carries light to the pixels as real rows are read and as saturated pixels overflow.

Letters: n planes, H rows, W columns. A row is read early or late by a normal number of ticks, drawn anew in each tick,
so the plane before it gains what it loses. Light above one spike per tick overflows: a share goes to the four
neighbours, evenly, and on from those that overflow in turn, REACH times; a drain takes the rest.
"""

import ctypes

import numpy as np
from numpy.typing import NDArray

from acquisition.native import Address, Kernel

REACH = 8  # pixels that overflow gets far
_read = Kernel(
    "acquisition",
    "sensor_readout",
    *(Address, *(ctypes.c_int64,) * 4, Address, ctypes.c_double, ctypes.c_double, ctypes.c_int32, Address),
    ctypes.c_int32,
)


def read_out(
    light: NDArray[np.float32],
    row_keys: NDArray[np.uint64],
    first_tick: int,
    jitter: float,
    blooming: float,
    *,
    threads: int = 1,
) -> NDArray[np.float32]:
    """Return the light [n, H, W] that reaches the pixels from `first_tick` on, spikes per tick.

    `row_keys` [H] draw each row's `jitter` (ticks, standard deviation); `blooming` is the share that neighbours get.
    """
    n, height, width = light.shape
    reached = np.empty_like(light)
    size = (n, height, width, first_tick)
    _read(light, *size, row_keys, jitter, blooming, REACH, reached, threads)
    return reached
