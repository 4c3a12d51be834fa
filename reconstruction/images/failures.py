"""Finds pixels that turn hot or stuck during a recording: lone ones that jump, and from then on see nothing change.

A clip is cut into equal spans, of which those in the dark tell nothing. A pixel that fails leaves its count at one span
and keeps the new one to the end, as constant light would make it, while its neighbours go on as before. Whatever moves
is seen by several pixels, since no lens draws finer than a pixel, so a mover takes its neighbours along. Letters:
S spans, H rows, W columns, K pixels.
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
ROUNDED = 0.01  # spikes by which counts are looked at more closely
_AROUND = [(dy, dx) for dy in range(3) for dx in range(3) if (dy, dx) != (1, 1)]  # in indices padded by one


def failing_pixels(stream: SpikeStream, light: Light, spans: int = SPANS) -> NDArray[np.int32]:
    """Return the plane [H, W] from which each pixel is of no use; NEVER for those that do not fail."""
    length = len(stream) // spans
    fails = np.full((stream.layout.height, stream.layout.width), NEVER, np.int32)
    if length < 2:
        return fails
    starts = [start for start, _ in light.lit([(n * length, (n + 1) * length) for n in range(spans)])]
    if len(starts) <= LEAST_SPANS:
        return fails
    counts = stream.window_counts([(start, start + length) for start in starts])
    gains = np.array([light.over(start, start + length) for start in starts], np.float32)
    varied = counts.max(axis=0) - counts.min(axis=0) >= JUMP
    rows, columns = np.nonzero(varied & (np.abs(np.subtract(*counts[-2:], dtype=np.int64)) <= STEADY))
    own = counts[:, rows, columns].astype(np.float32)
    lowest, highest = (f.accumulate(own[::-1], axis=0)[::-1] for f in (np.minimum, np.maximum))  # from a span on
    for number in range(len(starts) - LEAST_SPANS, 0, -1):  # the earliest jump is written last
        jumped, jump = _jumping(own, (lowest[number + 1], highest[number + 1]), gains, number)
        around = _around(counts, rows[jumped], columns[jumped])
        found = jumped[_alone(own[:, jumped], jump, around, gains, number)]
        fails[rows[found], columns[found]] = starts[number - 1]
    return fails


def _jumping(
    own: NDArray[np.float32], later: tuple[NDArray, NDArray], gains: NDArray[np.float32], number: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the pixels that leave their counts [S, K] for good in span `number`, and by how many spikes.

    `later` are their least and most counts [K] from then on, which rule most of them out.
    """
    least, most = later
    steady = np.flatnonzero(most - least <= STEADY)
    old, new = _parts(number)
    before = _median(own[None, old][:, :, steady] / gains[old, None])[0] * gains[new].mean()
    farthest = np.maximum(np.abs(least[steady] - before), np.abs(most[steady] - before))
    likely = steady[farthest >= JUMP - ROUNDED]
    jump = _jump(own[None][:, :, likely], gains, old, new)[0]
    return likely[jump >= JUMP], jump[jump >= JUMP]


def _parts(number: int) -> tuple[slice, slice]:
    """Return the spans before span `number` that are looked at, and those after it."""
    return slice(max(0, number - LEAST_SPANS), number), slice(number + 1, None)


def _median(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the median [n, K] of one, two or three values [n, 1 to 3, K]."""
    if values.shape[1] < 3:
        return values.mean(axis=1)
    first, second, third = np.moveaxis(values, 1, 0)
    return np.maximum(np.minimum(first, second), np.minimum(np.maximum(first, second), third))


def _around(counts: NDArray[np.uint32], rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the counts [8, S, K] of the neighbours of K pixels; beyond the border the picture is mirrored."""
    size = counts.shape[1:]
    down, across = (np.pad(np.arange(n), 1, mode="reflect" if min(size) > 1 else "edge") for n in size)
    found = [counts[:, down[rows + dy], across[columns + dx]] for dy, dx in _AROUND]
    return np.stack(found).astype(np.float32)


def _alone(
    own: NDArray[np.float32],
    jump: NDArray[np.float32],
    around: NDArray[np.float32],
    gains: NDArray[np.float32],
    number: int,
) -> NDArray[np.bool_]:
    """Return which pixels that `jump` [K] from their counts [S, K] in span `number` do so alone.

    `around` [8, S, K] are the counts of their neighbours. Flicker leaves a pixel alone that is hot or stuck.
    """
    if not own.shape[1]:
        return np.zeros(0, bool)
    old, new = _parts(number)
    after, later = own[new], around[:, new]
    least, most = later.min(axis=1), later.max(axis=1)
    before = _median(around[:, old] / gains[old, None]) * gains[new].mean()
    nearest = np.maximum(least - before, before - most).max(axis=0)  # by which some neighbour jumps at least
    calm = nearest <= FOLLOW * jump + ROUNDED
    calm[calm] = _jump(around[:, :, calm], gains, old, new).max(axis=0) <= FOLLOW * jump[calm]
    restless = ((most - least).min(axis=0) >= RESTLESS) & (after.mean(axis=0) >= JUMP)
    silent = (after.max(axis=0) == 0) & (later.mean(axis=1).min(axis=0) >= JUMP)
    return calm | restless | silent


def _jump(counts: NDArray[np.float32], gains: NDArray[np.float32], old: slice, new: slice) -> NDArray[np.float32]:
    """Return by how many spikes counts [n, S, K] change from the `old` spans to the `new` ones, [n, K]."""
    before = _median(counts[:, old] / gains[old, None])
    return np.abs(np.median(counts[:, new], axis=1) - before * gains[new].mean())
