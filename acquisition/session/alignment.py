"""Aligns cameras without a sync line, by a change of light that all of them see.

A flash is a step of the mean firing rate; how much of the step its plane has got says when within the plane it came.
Without one, the rates are cross-correlated, and the peak is interpolated. Either needs light that changes: what stands
still in even light, or repeats itself, is refused with the reason.

Letters: T planes of a camera; rates are its spikes per tick, averaged over all pixels.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from acquisition.recording.importing import Stream
from acquisition.session.timing import TimingError
from acquisition.spikes.packing import pack

Rates = NDArray[np.float64]
LARGEST_LAG = 1000  # planes
LEAST_OVERLAP = 32  # planes
_CHUNK = 256  # planes counted at a time
_STEP_NOISES = 8.0  # least rise of a flash, in standard deviations of the rate's own changes
_STEP_SHARE = 0.1  # least rise of a flash, as a share of the mean rate
_SMOOTHING = 5  # planes
_LEAST_CORRELATION = 0.7
_NEXT_BEST = 0.98  # share of the peak from which a second peak makes the lag a guess


def firing_rate(stream: Stream) -> Rates:
    """Return the mean spikes per pixel of every plane [T]."""
    bits, sums = pack(np.ones((1, stream.layout.height, stream.layout.width), np.uint8), stream.layout), []
    for first in range(0, len(stream), _CHUNK):
        packed = stream.window(first, min(first + _CHUNK, len(stream)))
        sums.append(np.bitwise_count(packed & bits).sum(axis=1, dtype=np.int64))
    return np.concatenate(sums) / (stream.layout.width * stream.layout.height)


def align_by_light(rates: Mapping[str, Rates]) -> dict[str, tuple[float, float]]:
    """Return how many planes after the first camera's each camera's plane 0 began, and the standard deviation.

    They are aligned by a flash where all see one, else by correlation. `rates` are each camera's spikes per tick and
    pixel [T], T its own. Raises TimingError naming the camera whose light does not change, or fits more than one lag.
    """
    for camera_id, rate in rates.items():
        if len(rate) < LEAST_OVERLAP:
            raise TimingError(f"found {len(rate)} planes", f"at least {LEAST_OVERLAP}", where=camera_id)
    seen = {camera_id: found for camera_id, rate in rates.items() if (found := flash(rate))}
    reference, *others = rates
    lags = {reference: (0.0, 0.0)}
    for camera_id in others:
        if len(seen) == len(rates):
            (at, sd), (instant, own_sd) = seen[reference], seen[camera_id]
            lags[camera_id] = at - instant, float(np.hypot(sd, own_sd))
        else:
            with TimingError.located(camera_id):
                lags[camera_id] = correlation_lag(rates[reference], rates[camera_id])
    return lags


def flash(rate: Rates) -> tuple[float, float] | None:
    """Return the instant in planes at which `rate` [T], in spikes per tick, steps, and its standard deviation.

    The first step of at least half the height of the highest one counts; planes before and after it must be level.
    Returns None without a step.
    """
    over_two = rate[2:] - rate[:-2]  # a step that falls inside a plane is whole over two
    noise = 1.4826 * float(np.median(np.abs(over_two - np.median(over_two))))
    highest = float(np.abs(over_two).max())
    if highest < max(_STEP_NOISES * noise, _STEP_SHARE * float(rate.mean()), 1e-9):
        return None
    first = int(np.flatnonzero(np.abs(over_two) > highest / 2)[0])
    plane = first + 1 + int(np.argmax(np.abs(over_two[first : first + 2])))  # it holds the step
    before, after = rate[max(0, plane - 8) : plane], rate[plane + 1 : plane + 4]
    if len(before) < 2 or len(after) < 2:
        return None
    step = float(np.median(after) - np.median(before))
    unrest = float(max(noise, before.std(), after.std()))
    if abs(step) < 5 * unrest:
        return None
    share = float(np.clip((np.median(after) - rate[plane]) / step, 0, 1))
    return plane + share, float(np.hypot(1.5 * unrest / abs(step), 1e-3))


def correlation_lag(reference: Rates, rate: Rates) -> tuple[float, float]:
    """Return how many planes after that of `reference` [S] the plane 0 of `rate` [T] began, and its standard deviation.

    Both are in spikes per tick.
    Raises TimingError where the light does not change, the two do not fit, or more than one lag fits.
    """
    for name, one in (("the reference's", reference), ("its", rate)):
        if not float(one.std()) > 1e-9:
            raise TimingError(f"found that {name} light never changes", "a flash or motion", "align by a flash")
    most = min(LARGEST_LAG, min(len(reference), len(rate)) // 2)
    lags = np.arange(-most, most + 1)
    reference, rate = _smoothed(reference), _smoothed(rate)
    scores = np.array([_correlation(*_overlap(reference, rate, int(lag))) for lag in lags])
    peak = int(np.argmax(scores))
    if scores[peak] < _LEAST_CORRELATION:
        raise TimingError(
            f"found a best correlation of {scores[peak]:.2f} with the reference's light",
            f"at least {_LEAST_CORRELATION}",
            "the light hardly changes, align by a flash",
        )
    if peak in (0, len(lags) - 1):
        raise TimingError(f"found no peak of the correlation within {most} planes", do="align by a flash")
    rivals = np.flatnonzero((scores[1:-1] >= scores[:-2]) & (scores[1:-1] >= scores[2:])) + 1
    rivals = [int(lags[k]) for k in rivals if k != peak and scores[k] > _NEXT_BEST * scores[peak]]
    if rivals:
        raise TimingError(
            f"found that lags of {lags[peak]} and {rivals[0]} planes fit alike",
            "one: the light repeats itself",
            "align by a flash",
        )
    left, top, right = scores[peak - 1 : peak + 2]
    bend = left - 2 * top + right
    lag = float(lags[peak] + (0.5 * (left - right) / bend if bend < 0 else 0.0))
    return lag, _lag_sd(*_overlap(reference, rate, int(lags[peak])))


def _smoothed(rate: Rates) -> Rates:
    """Return means over a few planes [T - 4]: where pixels fire in step, single planes are noisy, but not stretches."""
    return np.convolve(rate, np.full(_SMOOTHING, 1 / _SMOOTHING), mode="valid")


def _overlap(reference: Rates, rate: Rates, lag: int) -> tuple[Rates, Rates]:
    """Return planes k + lag of the reference beside planes k of the other, as many as both have."""
    first = max(0, -lag)
    count = min(len(reference) - lag, len(rate)) - first
    return reference[first + lag : first + lag + count], rate[first : first + count]


def _correlation(a: Rates, b: Rates) -> float:
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / scale if scale > 0 else 0.0


def _lag_sd(a: Rates, b: Rates) -> float:
    """Return the standard deviation of the best lag in planes, from its misfit: the least any estimator reaches."""
    a, b = a - a.mean(), b - b.mean()
    factor = (a @ b) / (b @ b)
    misfit = float(((a - factor * b) ** 2).mean())
    slopes = float(((factor * np.gradient(b)) ** 2).mean()) - misfit / 4  # what the noise of b adds to them
    return float(np.sqrt(misfit / slopes / len(a))) if slopes > 0 else float(len(a))
