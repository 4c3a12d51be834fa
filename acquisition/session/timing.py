"""Estimates each camera's clock against the rig clock, from the shared sync pulses it stamped.

Pulse n, from 0 for the trigger, happens at n * period on the rig clock. A camera that stamps it at t on its own clock
has t = offset + (1 + drift) * n * period + jitter. The line is fitted to the pulses that lie near it, so single late
stamps do not bend it. A camera counts the pulses it sees and need not stamp every one: where more periods passed
between two stamps than pulses were counted, pulses were missed. A long run keeps some of the stamps: pulses get their
numbers before any is dropped.

Letters: N stamped pulses.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.errors import AcquisitionError

Missed = tuple[tuple[int, ...], tuple[tuple[int, int, int], ...]]  # pulses; (first, last, how many) of some
MOST_STEPS = 1_000_000  # most periods between two stamps; more is a broken clock
MOST_STAMPS = 1 << 14  # most stamps of a camera that are kept: 65 s of all at 250 blocks a second
MOST_NAMED = 1000  # most pulses missed behind the last stamp that are named one by one; more are given as a range
_ON_THE_WAY = 0.1  # periods for which a pulse that is due may still be on its way
_FAR = 5.0  # robust standard deviations from the line; stamps farther off are not used
_FINEST_S = 1e-9  # resolution of a stamp in seconds


class TimingError(AcquisitionError):
    """Stamps or light from which no time can be told."""

    exit_code = 2
    bad_input = True


@dataclass(frozen=True)
class ClockEstimate:
    """One camera's clock against the rig clock, in seconds.

    The camera's clock is ahead by `skew_s` in the middle of the recording and by `offset_s` at its start (what it does
    at an instant, it does so much too early), and fast by `drift_ppm` millionths; their standard deviations are None
    where too few pulses were left to tell. `missed_pulses` were not seen; `missed_between` are (first, last, how many)
    of pulses some of which were not seen. `outlying_pulses` were stamped so far off that they are not used;
    `last_pulse` is the last one that was stamped.
    """

    skew_s: float
    skew_sd_s: float | None
    offset_s: float
    offset_sd_s: float | None
    drift_ppm: float | None
    drift_sd_ppm: float | None
    jitter_s: float | None
    pulses: int
    missed_pulses: tuple[int, ...] = ()
    missed_between: tuple[tuple[int, int, int], ...] = ()
    outlying_pulses: tuple[int, ...] = ()
    last_pulse: int = 0

    def with_missed_until(self, until_s: float, last_stamp_s: float, period_s: float) -> ClockEstimate:
        """Return the estimate with the pulses missed behind the last stamp, before `until_s` on the camera's clock.

        One that was due just before `until_s` may still be on its way, so it is not called missed.
        """
        here_s = period_s * (1 + (self.drift_ppm or 0.0) * 1e-6)
        count = math.floor((until_s - last_stamp_s) / here_s - _ON_THE_WAY)
        if not 0 < count <= MOST_STEPS:
            return self
        behind = range(self.last_pulse + 1, self.last_pulse + 1 + count)
        if count > MOST_NAMED:
            between = (*self.missed_between, (behind[0], behind[-1], count))
            return dataclasses.replace(self, missed_between=between)
        return dataclasses.replace(self, missed_pulses=(*self.missed_pulses, *behind))


@dataclass(frozen=True, eq=False)
class _Stamped:
    """Pulses `numbers` [N] of the line, 0 for the trigger, stamped at `stamps_s` [N], and those missed among them."""

    numbers: NDArray[np.int64]
    stamps_s: NDArray[np.float64]
    missed: Missed

    def before(self, later: _Stamped) -> _Stamped:
        """Return both, where `later` begins with the last pulse of these."""
        numbers, stamps_s = np.r_[self.numbers[:-1], later.numbers], np.r_[self.stamps_s[:-1], later.stamps_s]
        return _Stamped(numbers, stamps_s, (self.missed[0] + later.missed[0], self.missed[1] + later.missed[1]))

    def newest(self, count: int) -> _Stamped:
        """Return the last `count`, and what was missed among them."""
        numbers, (surely, among) = self.numbers[-count:], self.missed
        since = tuple(n for n in surely if n > numbers[0]), tuple(each for each in among if each[0] > numbers[0])
        return _Stamped(numbers, self.stamps_s[-count:], since)

    def thinned(self) -> _Stamped:
        """Return every second one, the last included, and all that were missed."""
        return _Stamped(self.numbers[::-2][::-1], self.stamps_s[::-2][::-1], self.missed)


class StampLog:
    """Keeps the pulses that one camera counts and stamps, at most about MOST_STAMPS; one thread adds, others may ask.

    Before the recording begins the newest are kept, from then on every one, then every second, fourth ... of them.
    """

    def __init__(self, period_s: float):
        self.period_s = period_s
        self._lock = threading.Lock()
        self._kept: _Stamped | None = None
        self._new: list[tuple[int, float]] = []  # pulses counted since the trigger, and when the last of them came
        self._amiss: TimingError | None = None

    def add(self, counted: int, stamp_s: float, *, recorded: bool) -> None:
        """Take a stamp of the last of `counted` pulses, 0 for the trigger; `recorded`: the recording has begun."""
        with self._lock:
            if self._amiss:
                return
            self._new.append((counted, stamp_s))
            if len(self._new) <= MOST_STAMPS // 2:
                return
            try:
                found = self._all()
            except TimingError as error:
                self._amiss, self._new = error, []
                return
            if len(found.numbers) > MOST_STAMPS:
                found = found.thinned() if recorded else found.newest(MOST_STAMPS // 2)
            self._kept, self._new = found, self._new[-1:]

    def estimate(self, begin_s: float, duration_s: float, until_s: float | None = None) -> ClockEstimate:
        """Return the camera's clock in a recording that begins `begin_s` after the trigger; raises TimingError.

        Pulses due before `until_s` on the camera's clock, behind the last stamp, count as missed.
        """
        with self._lock:
            if self._amiss:
                raise self._amiss
            stamped = self._all()
        estimate = _fit(stamped, self.period_s, begin_s, duration_s / 2)
        if until_s is None:
            return estimate
        return estimate.with_missed_until(until_s, float(stamped.stamps_s[-1]), self.period_s)

    def _all(self) -> _Stamped:
        """Return what is kept with what is new, which begins with the last one kept."""
        counted, stamps_s = (np.array(each) for each in zip(*self._new, strict=True)) if self._new else ([], [])
        found = _numbered(counted, stamps_s, self.period_s, None if self._kept is None else self._kept.numbers[-1])
        return found if self._kept is None else self._kept.before(found)


def estimate_clock(
    counted: NDArray[np.integer], stamps_s: NDArray[np.float64], period_s: float, duration_s: float
) -> ClockEstimate:
    """Return the clock of a camera that had counted `counted` [N] pulses when it stamped one at `stamps_s` [N].

    The trigger is pulse 0, with which the recording begins; a pulse may be given more than once. Stamps are seconds on
    the camera's clock, `period_s` is the time between pulses on the rig clock, `duration_s` the length of the
    recording. Raises TimingError for no pulses, arrays of different lengths, numbers that are not finite, or a clock
    that stands still or goes backwards.
    """
    return _fit(_numbered(counted, stamps_s, period_s), period_s, 0.0, duration_s / 2)


def _numbered(counted: ArrayLike, stamps_s: ArrayLike, period_s: float, first: int | None = None) -> _Stamped:
    """Return which pulses were stamped, from the periods between stamps; `first` is the number of the first one.

    Where that is None, none was missed before it.
    """
    counted, stamps_s = np.asarray(counted, dtype=np.int64), np.asarray(stamps_s, dtype=np.float64)
    _refuse_useless(counted, stamps_s, period_s)
    new = np.r_[True, np.diff(counted) > 0]
    counted, stamps_s = counted[new], stamps_s[new]
    if len(counted) > 1 and np.ptp(stamps_s) < period_s / 2:
        raise TimingError(f"found {len(counted)} pulses within {np.ptp(stamps_s):g} s: the camera's clock stands still")
    steps = np.rint(np.diff(stamps_s) / period_s)
    if steps.max(initial=0) > MOST_STEPS:
        raise TimingError(f"found {steps.max():g} periods between two stamps", f"at most {MOST_STEPS}")
    pulses = int(counted[0] if first is None else first) + np.r_[0, np.cumsum(steps)].astype(np.int64)
    return _Stamped(pulses, stamps_s, _missed(pulses, np.diff(counted)))


def _refuse_useless(counted: NDArray, stamps_s: NDArray[np.float64], period_s: float) -> None:
    if not period_s > 0:
        raise TimingError(f"found a pulse period of {period_s} s", "a positive one")
    if counted.ndim != 1 or counted.shape != stamps_s.shape:
        raise TimingError(f"found {counted.shape} counts and {stamps_s.shape} stamps", "as many of each")
    if not len(counted):
        raise TimingError("found no sync pulse", "at least one", "check the sync line")
    if not np.isfinite(stamps_s).all():
        raise TimingError("found a stamp that is not a finite number of seconds")
    if (np.diff(stamps_s) < 0).any() or (np.diff(counted) < 0).any():
        raise TimingError("found stamps or counts that go backwards", "rising ones", "the camera was restarted")


def _missed(pulses: NDArray[np.int64], counted_steps: NDArray) -> Missed:
    """Return the pulses that were missed, and the stretches in which some were."""
    surely, among = [], []
    short = np.diff(pulses) - counted_steps
    for k in np.flatnonzero(short > 0):
        first, last = int(pulses[k]) + 1, int(pulses[k + 1]) - 1
        if short[k] > last - first:
            surely += range(first, last + 1)
        else:
            among.append((first, last, int(short[k])))
    return tuple(surely), tuple(among)


def _fit(stamped: _Stamped, period_s: float, begin_s: float, half_s: float) -> ClockEstimate:
    """Fit error = offset + drift * time to the stamps near the line; the recording is [begin, begin + 2 half]."""
    pulses, missed = stamped.numbers, stamped.missed
    rig_s = pulses.astype(np.float64) * period_s
    error_s = stamped.stamps_s - rig_s
    near = _near_the_line(rig_s, error_s)
    named = {
        "pulses": len(pulses),
        "missed_pulses": missed[0],
        "missed_between": missed[1],
        "outlying_pulses": tuple(pulses[~near].tolist()),
        "last_pulse": int(pulses[-1]),
    }
    times, errors = rig_s[near], error_s[near]
    count, center = len(times), float(times.mean())
    spread = float(((times - center) ** 2).sum())
    if count < 2 or spread == 0:
        at = float(np.median(errors))
        return ClockEstimate(at, None, at, None, None, None, None, **named)
    drift = float(((times - center) * (errors - errors.mean())).sum() / spread)
    mean = float(errors.mean())
    jitter = None
    if count > 2:
        residuals = errors - mean - drift * (times - center)
        jitter = max(float(np.sqrt((residuals**2).sum() / (count - 2))), _FINEST_S / np.sqrt(12))

    def error_at(time_s: float) -> tuple[float, float | None]:
        value = mean + drift * (time_s - center)
        return value, jitter and float(jitter * np.sqrt(1 / count + (time_s - center) ** 2 / spread))

    drift_sd = jitter and float(jitter / np.sqrt(spread) * 1e6)
    return ClockEstimate(*error_at(begin_s + half_s), *error_at(begin_s), drift * 1e6, drift_sd, jitter, **named)


def _near_the_line(rig_s: NDArray[np.float64], error_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which stamps [N] are within a few robust standard deviations of the median line."""
    half = len(rig_s) // 2
    if half == 0:
        return np.ones(len(rig_s), dtype=bool)
    steps = rig_s[half:] - rig_s[: len(rig_s) - half]
    rises = error_s[half:] - error_s[: len(rig_s) - half]
    slope = np.median(rises[steps > 0] / steps[steps > 0]) if (steps > 0).any() else 0.0
    residuals = error_s - slope * rig_s
    residuals = np.abs(residuals - np.median(residuals))
    return residuals <= _FAR * max(1.4826 * float(np.median(residuals)), _FINEST_S)
