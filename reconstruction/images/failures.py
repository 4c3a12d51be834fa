"""Finds pixels that turn hot or stuck during a recording: lone ones that jump, and from then on see nothing change.

A clip is cut into equal spans. A pixel that fails leaves its count at one span and keeps the new one to the end, as
constant light would make it, while its neighbours go on as before. Whatever moves is seen by several pixels, since no
lens draws finer than a pixel, so a mover takes its neighbours along. Letters: S spans, H rows, W columns, K pixels.
"""

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.flicker import Light
from reconstruction.images.response import NEVER

SPANS = 16
LEAST_SPANS = 3  # spans after which a pixel must keep its new count
STEADY = 2.2  # spikes that two counts of constant light may differ by: both ends of both, and shot noise
JUMP = 4.0  # spikes of a count that a failing pixel leaves its old one by, at least
FOLLOW = 0.4  # share of its jump that any of its neighbours may take part in
RESTLESS = 6.0  # spikes by which the counts of all neighbours vary where a mover goes on passing
_AROUND = [(dy, dx) for dy in range(3) for dx in range(3) if (dy, dx) != (1, 1)]  # in an image padded by one


def failing_pixels(stream: SpikeStream, light: Light, spans: int = SPANS) -> NDArray[np.int32]:
    """Return the plane [H, W] from which each pixel is of no use; NEVER for those that do not fail."""
    length = len(stream) // spans
    fails = np.full((stream.layout.height, stream.layout.width), NEVER, np.int32)
    if length < 2:
        return fails
    starts = [number * length for number in range(spans)]
    counts = np.stack([stream.counts(start, start + length) for start in starts]).astype(np.float32)
    gains = np.array([light.over(start, start + length) for start in starts], np.float32)
    rows, columns = np.nonzero((np.abs(counts[-1] - counts[-2]) <= STEADY) & (np.ptp(counts, axis=0) >= JUMP))
    if not len(rows):
        return fails
    padded = np.pad(counts, ((0, 0), (1, 1), (1, 1)), mode="reflect" if min(fails.shape) > 1 else "edge")
    own, around = counts[:, rows, columns], np.stack([padded[:, rows + dy, columns + dx] for dy, dx in _AROUND])
    for number in range(spans - LEAST_SPANS, 0, -1):  # the earliest jump is written last
        found = _jumped(own, around, gains, number)
        fails[rows[found], columns[found]] = starts[number - 1]
    return fails


def _jumped(
    own: NDArray[np.float32], around: NDArray[np.float32], gains: NDArray[np.float32], number: int
) -> NDArray[np.int64]:
    """Return the pixels that leave their counts [S, K] for good in span `number`; `around` [8, S, K] are neighbours'.

    Flicker leaves a pixel alone that is hot or stuck.
    """
    old, new = slice(max(0, number - LEAST_SPANS), number), slice(number + 1, None)
    jump = _jump(own[None], gains, old, new)[0]
    likely = np.flatnonzero((np.ptp(own[new], axis=0) <= STEADY) & (jump >= JUMP))
    if not len(likely):
        return likely
    jump, after, others = jump[likely], own[new][:, likely], around[:, :, likely]
    calm = _jump(others, gains, old, new).max(axis=0) <= FOLLOW * jump
    restless = (np.ptp(others[:, new], axis=1).min(axis=0) >= RESTLESS) & (after.mean(axis=0) >= JUMP)
    silent = (after.max(axis=0) == 0) & (others[:, new].mean(axis=1).min(axis=0) >= JUMP)
    return likely[calm | restless | silent]


def _jump(counts: NDArray[np.float32], gains: NDArray[np.float32], old: slice, new: slice) -> NDArray[np.float32]:
    """Return by how many spikes counts [n, S, K] change from the `old` spans to the `new` ones, [n, K]."""
    before = np.median(counts[:, old] / gains[old, None], axis=1)
    return np.abs(np.median(counts[:, new], axis=1) - before * gains[new].mean())
