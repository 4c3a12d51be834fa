"""Adaptive window: for each pixel the longest slope that no shorter one contradicts.

A ladder of least-squares slopes (`slope`) around the instant, each with its standard deviation. From the shortest up,
the confidence intervals rate +- CONFIDENCE * sigma must all have a point in common; the first window that breaks this
has met a change of light, and the one before it is taken. So a pixel reads the whole ladder where nothing moves and
about a millisecond where an edge passes. A 3x3 minimum over the choice keeps a mover's neighbours from reading past it.
Order: within 1 dB of the best single window on still parts and of the best single one on moving parts, at once. Not to
be confused with `background`, which needs the whole clip. Cost: one pass over the longest window, one sum a rung.
Source of the rule: Goldenshluger and Nemirovski, "On spatially adaptive estimation of nonparametric regression", 1997
(intersection of confidence intervals, Katkovnik 1999). The ladder, the confidence and the minimum are ours, chosen on
`fan_and_ball`, seeds 1 to 3.

Letters: K rungs, H rows, W columns.
"""

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.intervals import weighted_counts
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.catalogue import Estimate, ImageMethod
from reconstruction.images.methods.slope import slope_weights
from reconstruction.images.noise import slope_sigma

HALF_WINDOWS = (8, 11, 16, 23, 32, 45, 64, 91, 128)
CONFIDENCE = 3.0  # standard deviations
LEVELS = 1024


def adaptive(stream: SpikeStream, plane: int) -> Estimate:
    """Return the image at `plane` from 17 to 257 planes a pixel."""
    first, last = stream.around(plane, HALF_WINDOWS[-1])
    bounds = [stream.around(plane, half) for half in HALF_WINDOWS]
    weights = np.zeros((len(bounds), last - first), dtype=np.int64)
    for row, (start, end) in zip(weights, bounds, strict=True):
        row[start - first : end - first] = slope_weights(end - start)
    totals = weights.sum(axis=1)
    sums = weighted_counts(stream.window(first, last), stream.layout, weights)
    rates = (sums / totals[:, None, None]).astype(np.float32)
    planes = [end - start for start, end in bounds]
    rung = longest_unbroken(rates, planes)[None]
    rate, total = np.take_along_axis(rates, rung, axis=0)[0], totals[rung[0]]
    fired = np.take_along_axis(sums, rung, axis=0)[0]
    return Estimate(rate, (fired > 0) & (fired < total), slope_sigma(rate, np.array(planes)[rung[0]]))


def longest_unbroken(rates: NDArray[np.float32], planes: list[int]) -> NDArray[np.int64]:
    """Choose the rung [H, W] for each pixel, from slopes [K, H, W] over `planes` each, shortest first.

    A few spikes cannot tell their own rate, so a rung's deviation is no less than the longest window's rate makes it.
    Deviations come from a table over `LEVELS` rates: computing each pixel's would take most of the time.
    """
    levels = np.linspace(0, 1, LEVELS, dtype=np.float32)
    longest = _level(rates[-1])
    low = np.full(rates.shape[1:], -np.inf, dtype=np.float32)
    high, unbroken = -low, np.ones(low.shape, dtype=bool)
    rung = np.zeros(low.shape, dtype=np.uint8)
    for number, (rate, n) in enumerate(zip(rates, planes, strict=True)):
        table = np.float32(CONFIDENCE) * slope_sigma(levels, n)
        reach = np.maximum(table[_level(rate)], table[longest])
        low, high = np.maximum(low, rate - reach), np.minimum(high, rate + reach)
        unbroken &= low <= high
        rung[unbroken] = number
    return _least_around(rung).astype(np.int64)


def _least_around(rung: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the least of each 3x3 neighbourhood [H, W], cut at the edges: the service draws without OpenCV."""
    padded = np.pad(rung, 1, constant_values=255)
    rows = np.minimum(np.minimum(padded[:-2], padded[1:-1]), padded[2:])
    return np.minimum(np.minimum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])


def _level(rate: NDArray[np.float32]) -> NDArray[np.int16]:
    return (rate * np.float32(LEVELS - 1)).astype(np.int16)


METHOD = ImageMethod("adaptive", adaptive, price_s=0.031)
