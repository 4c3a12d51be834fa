"""Interpolated count: the charge of a short window over its length, as if light were constant within every interval.

Between two spikes a pixel collects the charge of one spike. So the charge since the last spike follows, at any instant,
from the share of the interval that has passed. The difference of two such clocks is a count with a fraction. It has the
blur of a short mean and the quantisation of a long one, and dark pixels need no longer window. It is the mean of TFI
over the window's instants.
Order: between TFI (a window of one plane) and TFP. Short windows suit whatever averages over many instants itself; they
are noisier and less blurred. The window was chosen on `fan_and_ball`, seed 1, as targets of a training.
Before a pixel's first spike, and after its last, its clock goes as in the nearest whole interval. Where there is none,
or no spike within reach, the clock is taken for half past; a pixel without any spike gets the most light that the
silence allows. Neither is valid, nor is a pixel that always fires in the window.
Cost: two searches as of TFI and one count; all else is done for the pixels of `focus` alone. Source: Zhu et al., ICME
2019 (the interval as a pixel's light).
"""

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.intervals import Intervals, intervals
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.catalogue import Estimate, Focus, ImageMethod
from reconstruction.images.noise import interpolated_sigma

HALF_WINDOW = 4
PLANES = 2 * HALF_WINDOW + 1
REACH = 128


def interpolated(
    stream: SpikeStream, plane: int, half_window: int = HALF_WINDOW, *, focus: Focus | None = None
) -> Estimate:
    """Return the image at `plane` from the charge of up to 2 * half_window + 1 planes, zero where no `focus` is."""
    first, last = stream.around(plane, half_window)
    ends = [first - 1, last - 1]  # the planes after which the window begins and ends
    asked = [max(end, 0) for end in ends]
    found = intervals(stream.packed, stream.layout, asked, REACH, wanted=focus.packed if focus else None)
    counts = stream.counts(first, last)
    if focus:
        found, counts = Intervals(*(focus.taken(part) for part in found)), focus.taken(counts)
    if first == 0:
        _set_before_all(found)
    outer = [_outer(stream, end, focus) for end in ends]
    both = (_clock(Intervals(*part), own) for part, own in zip(zip(*found, strict=True), outer, strict=True))
    clocks, known = zip(*both, strict=True)
    charge = counts + clocks[1] - clocks[0]
    rate = (np.maximum(charge, 0) / np.float32(last - first)).astype(np.float32)
    sure, longest = known[0] & known[1], np.maximum(found.ticks[0], found.ticks[1])
    np.copyto(rate, 1 / longest.astype(np.float32), where=~sure & (rate <= 0))
    parts = rate, sure & (rate < 1), interpolated_sigma(rate, longest, last - first)
    shape = stream.layout.height, stream.layout.width
    return Estimate(*(focus.spread(part, shape) for part in parts)) if focus else Estimate(*parts)


def _set_before_all(found: Intervals) -> None:
    """Move the first instant, which was found at plane 0, to just before plane 0, where no spike lies before."""
    ticks, since, before, after = (part[0] for part in found)
    np.copyto(ticks, np.where(before, 1, ticks - since + 1))
    after |= before
    since[:], before[:] = 0, False


def _outer(stream: SpikeStream, end: int, focus: Focus | None) -> NDArray[np.uint16]:
    """Return the stream's outermost whole intervals [2, ...] in ticks; 0 for a side that `end` is out of reach of."""
    near = np.array([end < REACH, end >= len(stream) - REACH])
    if not near.any():
        return np.zeros((2, 1), np.uint16)
    outer = focus.taken(stream.outermost) if focus else stream.outermost
    return outer * near.reshape(2, *[1] * (outer.ndim - 1))


def _clock(found: Intervals, outer: NDArray[np.uint16]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the charge since the last spike [...] at an end, in spikes, and where it is known.

    `outer` [2, ...]: ticks of the intervals to go by where no spike is before, and where none is after; 0 for none.
    """
    ticks, since, before, after = found
    early, late = after & ~before & (outer[0] > 0), before & ~after & (outer[1] > 0)
    first, last = np.maximum(outer, 1)
    clock = ((since + np.float32(0.5)) / ticks).astype(np.float32)
    np.copyto(clock, 1 - (ticks - since - np.float32(0.5)) / first, where=early)
    np.copyto(clock, (since + np.float32(0.5)) / last, where=late)
    known = (before & after) | early | late
    return np.where(known, np.clip(clock, 0, 1), np.float32(0.5)), known


METHOD = ImageMethod("interpolated", interpolated, price_s=0.0010, focuses=True)
