"""Suspects a stream that was decoded with the wrong bit order.

Pixels beside each other are alike. Where the bits of every byte are read backwards, the pixels on both sides of a byte
boundary are really 15 apart, and differ as pixels 15 apart do. On a real recording of a car, the mean step of a
32-plane mean across byte boundaries is 0.0159 read rightly and 0.0769 read backwards; within bytes it is 0.0162.
A picture that is upside down shows no such trace; the pictures of several cameras do (`recording.flip`).
"""

import dataclasses

import numpy as np

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.m1k40 import M1K40Stream
from acquisition.spikes.packing import Bytes, counts
from acquisition.spikes.stream import SpikeStream

WINDOW_PLANES = 32
WORSE = 1.25  # suspicious ratio of the step to that of the other order
LEAST_BOUNDARIES = 200  # fewest boundaries that tell anything


def boundary_step(packed: Bytes, layout: PlaneLayout) -> float:
    """Return the mean step of spikes per tick between neighbouring pixels across byte boundaries; NaN for too few.

    `packed` [T, B] are the planes to average over.
    """
    mean = counts(packed, dataclasses.replace(layout, row_order="top")) / max(1, len(packed))
    steps = np.abs(np.diff(mean, axis=1))
    pixel = np.arange(layout.height)[:, None] * layout.stored_width + np.arange(1, layout.width)
    across = pixel % 8 == 0
    return float(steps[across].mean()) if across.sum() >= LEAST_BOUNDARIES else float("nan")


def middle_window(stream: SpikeStream | M1K40Stream) -> Bytes:
    """Return a few packed planes [T, B] from the middle of a stream."""
    first = max(0, len(stream) // 2 - WINDOW_PLANES // 2)
    return stream.window(first, min(len(stream), first + WINDOW_PLANES))


def suspected_bit_order(stream: SpikeStream) -> str | None:
    """Return a line that says why the other bit order fits the middle of the stream better, or None."""
    packed = middle_window(stream)
    given = stream.layout.bit_order
    other = "msb" if given == "lsb" else "lsb"
    here = boundary_step(packed, stream.layout)
    there = boundary_step(packed, dataclasses.replace(stream.layout, bit_order=other))
    if not here > WORSE * there:
        return None
    return (
        f"pixels on both sides of a byte boundary differ by {here:.4f} spikes per tick read {given} first and by "
        f"{there:.4f} read {other} first; import it with --bit-order {other}"
    )
