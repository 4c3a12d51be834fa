"""Finds pixels that turn hot or stuck during a recording: lone ones that jump, and from then on see nothing change.

A clip is cut into equal spans. A pixel that fails leaves its count at one span and keeps the new one to the end, as
constant light would make it, while its neighbours go on as before. Whatever moves is seen by several pixels, since no
lens draws finer than a pixel, so a mover takes its neighbours along. Letters: S spans, H rows, W columns.
"""

import cv2
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
_AROUND = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)

Mask = NDArray[np.bool_]


def failing_pixels(stream: SpikeStream, light: Light, spans: int = SPANS) -> NDArray[np.int32]:
    """Return the plane [H, W] from which each pixel is of no use; NEVER for those that do not fail."""
    length = len(stream) // spans
    shape = (stream.layout.height, stream.layout.width)
    fails = np.full(shape, NEVER, np.int32)
    if length < 2:
        return fails
    starts = [number * length for number in range(spans)]
    counts = np.stack([stream.counts(start, start + length) for start in starts]).astype(np.float32)
    gains = np.array([light.over(start, start + length) for start in starts], np.float32)
    for number in range(spans - LEAST_SPANS, 0, -1):  # the earliest jump is written last
        found = _jumped(counts, gains, number)
        fails[found] = starts[number - 1]
    return fails


def _jumped(counts: NDArray[np.float32], gains: NDArray[np.float32], number: int) -> Mask:
    """Return which pixels [H, W] leave their counts [S, H, W] for good in span `number`."""
    after, steady = counts[number + 1 :], np.ptp(counts[number + 1 :], axis=0)  # flicker leaves a hot pixel alone
    if not (steady <= STEADY).any():
        return steady <= STEADY
    before = np.median((counts[:number] / gains[:number, None, None])[-LEAST_SPANS:], axis=0)
    jump = np.abs(np.median(after, axis=0) - before * gains[number + 1 :].mean())
    calm = _most_around(jump) <= FOLLOW * jump
    restless = (_least_around(steady) >= RESTLESS) & (after.mean(axis=0) >= JUMP)
    silent = (after.max(axis=0) == 0) & (_least_around(after.mean(axis=0)) >= JUMP)
    return (steady <= STEADY) & (jump >= JUMP) & (calm | restless | silent)


def _most_around(image: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(cv2.dilate(image, _AROUND), np.float32)


def _least_around(image: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(cv2.erode(image, _AROUND), np.float32)
