"""The flicker of the light: one gain a plane for the whole scene, read off what stands still.

Letters: T planes, V views. Blocks of pixels are compared with what they mostly show over the clip; at any instant
movers change few of them, so the median block tells how bright the light is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream
from reconstruction.parallel import each

WINDOW = 4  # planes counted together
BLOCK_PX = 8
LEAST_SPIKES = 4.0  # a block and window, on average; dimmer blocks say little
DARK = 0.05  # share of the usual light below which nothing is seen
BRIGHT_PERCENTILE = 90  # of the windows, a usual one, also where most of them are dark
TOGETHER = 4096  # windows compared at a time
LET_GO_EVERY = 64  # windows that are counted until what was read of a file is handed back
MEDIAN_NOISE = 1.25  # deviation of a median over that of the mean of as many spikes, were they a Poisson process
SURE = 3.0  # deviations by which the gains must vary: a few dim blocks tell nothing
FLICKER = 0.01  # standard deviation of the gain from which light is said to flicker; noise alone leaves some 0.002


@dataclass(frozen=True, eq=False)
class Light:
    """Gains [T] float32 of mean 1: the light of a plane over that of the clip."""

    gains: NDArray[np.float32]

    @classmethod
    def steady(cls, planes: int) -> Light:
        """Return light that does not change."""
        return cls(np.ones(planes, dtype=np.float32))

    @property
    def flickers(self) -> bool:
        """Return whether there is anything to correct."""
        return bool(self.gains.std() > FLICKER)

    def over(self, first: int, last: int) -> float:
        """Return the mean gain of planes [first, last)."""
        return float(self.gains[first:last].mean())

    def lit(self, windows: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
        """Return those of the windows [first, last) in which there is light enough to see by."""
        return [window for window in windows if self.over(*window) >= DARK]


def estimate_light(streams: Sequence[SpikeStream]) -> Light:
    """Estimate the light over the planes that V streams share; steady where no change stands out."""
    planes = min(len(stream) for stream in streams)
    starts = range(0, planes - WINDOW + 1, WINDOW)
    if len(starts) < 3:
        return Light.steady(planes)
    counted = each(lambda stream: _seen(spikes_of_blocks(stream, starts)), streams)
    views = [seen for seen in counted if len(seen.mostly)]
    if not views:
        return Light.steady(planes)
    ratios = np.concatenate([_ratios(views, first) for first in range(0, len(starts), TOGETHER)])
    if ratios.std() < SURE * MEDIAN_NOISE / np.sqrt(np.concatenate([seen.mostly for seen in views]).sum()):
        return Light.steady(planes)
    middles = np.array(starts) + (WINDOW - 1) / 2
    ends = np.array([-0.5, planes - 0.5])  # straight on from the outer windows
    slopes = np.array([ratios[1] - ratios[0], ratios[-1] - ratios[-2]]) / WINDOW
    outer = ratios[[0, -1]] + slopes * (ends - middles[[0, -1]])
    places, values = np.r_[ends[0], middles, ends[1]], np.r_[outer[0], ratios, outer[1]]
    gains = np.maximum(np.interp(np.arange(planes), places, values), 0)
    light = Light((gains / gains.mean()).astype(np.float32))
    return light if light.flickers else Light.steady(planes)


class _Seen(NamedTuple):
    """The blocks of a view that tell anything: their counts [windows, blocks], and what they mostly count [blocks]."""

    counts: NDArray[np.uint16]
    mostly: NDArray[np.float32]


def _seen(counts: NDArray[np.uint16]) -> _Seen:
    """Return the blocks of counts [windows, blocks] that mostly see something in the windows that are not dark."""
    sums = counts.sum(axis=1, dtype=np.uint32)
    lit = sums >= max(1, DARK * np.percentile(sums, BRIGHT_PERCENTILE))
    if not lit.any():
        return _Seen(counts[:, :0], np.zeros(0, np.float32))
    mostly = np.median(counts if lit.all() else counts[lit], axis=0).astype(np.float32)
    telling = mostly >= LEAST_SPIKES
    return _Seen(counts[:, telling], mostly[telling])


def _ratios(views: Sequence[_Seen], first: int) -> NDArray[np.floating]:
    """Return the light of some windows from `first` on, over the usual one: the median block's.

    A view that is dark while others are not is a camera that was lost, not light that went out.
    """
    found = [seen.counts[first : first + TOGETHER] / seen.mostly for seen in views]
    lost = np.stack([np.median(ratios, axis=1) < DARK for ratios in found])
    if not (lost.any(axis=0) & ~lost.all(axis=0)).any():
        return np.median(np.concatenate(found, axis=1), axis=1)
    lost &= ~lost.all(axis=0)
    kept = [np.where(gone[:, None], np.float32(np.nan), ratios) for gone, ratios in zip(lost, found, strict=True)]
    return np.nanmedian(np.concatenate(kept, axis=1), axis=1)


def spikes_of_blocks(stream: SpikeStream, starts: range) -> NDArray[np.uint16]:
    """Count the spikes of each block over each window, to [windows, blocks]."""
    layout = stream.layout
    rows, columns = (np.arange(n := max(1, size // BLOCK_PX)) * size // n for size in (layout.height, layout.width))
    found = np.empty((len(starts), len(rows) * len(columns)), np.uint16)
    bytewise = layout.stored_width == layout.width == BLOCK_PX * len(columns)  # a block's row is a byte
    flip = slice(None, None, -1 if layout.row_order == "bottom" else 1)
    for number, start in enumerate(starts):
        if bytewise:
            counts = np.bitwise_count(stream.window(start, start + WINDOW)).sum(axis=0, dtype=np.uint8)
            sums = np.add.reduceat(counts.reshape(layout.height, -1)[flip], rows, axis=0, dtype=np.uint32)
        else:
            counts = stream.counts(start, start + WINDOW)
            sums = np.add.reduceat(np.add.reduceat(counts, rows, axis=0), columns, axis=1)
        found[number] = sums.ravel()
        if number % LET_GO_EVERY == LET_GO_EVERY - 1:
            stream.let_go()
    return found
