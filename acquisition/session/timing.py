"""Each camera's clock against the rig clock, from the shared sync pulses it stamped.

Pulse n happens at n * period on the rig clock. A camera that stamps it at t on its own clock, which the trigger set to
zero, has t = offset + (1 + drift) * n * period + jitter. The line is fitted to the pulses that lie near it, so single
late stamps do not bend it; a pulse the camera did not see leaves a step of two periods and is named.

Letters: N stamped pulses.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import AcquisitionError

LARGEST_DRIFT = 2e-4  # of a camera's crystal; the usual ones stay below 5e-5
MOST_MISSED = 1_000_000  # pulses in a row; more is a broken clock
_FAR = 5.0  # robust standard deviations; stamps farther from the line are not used
_FINEST_S = 1e-9  # the resolution of a stamp


class TimingError(AcquisitionError):
    """Stamps or light from which no time can be told; the message is the reason."""

    exit_code = 2


@dataclass(frozen=True)
class ClockEstimate:
    """One camera's clock against the rig clock, in seconds.

    `skew_s` is how far the camera's clock is ahead in the middle of the clip, `offset_s` at its start, `drift_ppm` by
    how many millionths it is fast; their standard deviations are None where too few pulses were left to tell.
    `missed_pulses` were not stamped, `outlying_pulses` not used.
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
    outlying_pulses: tuple[int, ...] = ()

    def to_json(self) -> dict[str, object]:
        """The estimate as a JSON object of the same names."""
        return dataclasses.asdict(self)


def estimate_clocks(
    stamps: Mapping[str, tuple[NDArray[np.integer], NDArray[np.float64]]],
    period_s: float,
    duration_s: float,
    pulses_sent: int | None = None,
) -> dict[str, ClockEstimate]:
    """`estimate_clock` for each camera; TimingError names the camera.

    Without `pulses_sent`, the last pulse that any camera saw is the last that was sent.
    """
    numbered = {}
    for camera_id, (counted, device_time_s) in stamps.items():
        try:
            numbered[camera_id] = _numbers(np.asarray(counted), np.asarray(device_time_s, np.float64), period_s)
        except TimingError as error:
            raise TimingError(f"{camera_id}: {error}") from error
    sent = pulses_sent or 1 + max(int(pulses.max()) for pulses in numbered.values())
    return {
        camera_id: _fit(pulses, np.asarray(stamps[camera_id][1], np.float64), (period_s, duration_s / 2), sent)
        for camera_id, pulses in numbered.items()
    }


def estimate_clock(
    counted: NDArray[np.integer],
    device_time_s: NDArray[np.float64],
    period_s: float,
    duration_s: float,
    pulses_sent: int | None = None,
) -> ClockEstimate:
    """The clock of a camera that stamped the pulses it counted [N] at `device_time_s` [N], in a clip of `duration_s`.

    The camera's own count may pass over a missed pulse or skip its number; the stamps decide. Raises TimingError for no
    pulses, arrays of different lengths, numbers that are not finite, or a clock that stands still.
    """
    return estimate_clocks({"camera": (counted, device_time_s)}, period_s, duration_s, pulses_sent)["camera"]


def _numbers(counted: NDArray[np.integer], stamps_s: NDArray[np.float64], period_s: float) -> NDArray[np.int64]:
    """The number [N] of each pulse as it was sent."""
    if not period_s > 0:
        raise TimingError(f"found a pulse period of {period_s} s, expected a positive one")
    if counted.ndim != 1 or counted.shape != stamps_s.shape:
        raise TimingError(f"found {counted.shape} counts and {stamps_s.shape} stamps, expected as many of each")
    if not len(counted):
        raise TimingError("found no sync pulse, expected at least one; check the sync line")
    if not np.isfinite(stamps_s).all():
        raise TimingError("found a stamp that is not a finite number of seconds")
    if len(counted) > 1 and np.ptp(stamps_s) < period_s / 2:
        raise TimingError(f"found {len(counted)} pulses within {np.ptp(stamps_s):g} s: the camera's clock stands still")
    if (np.diff(stamps_s) < 0).any():
        raise TimingError("found stamps that go backwards, expected rising ones; the camera was restarted")
    steps = np.rint(np.diff(stamps_s) / period_s)
    if steps.max(initial=0) > MOST_MISSED:
        raise TimingError(f"found {steps.max():g} periods between two stamps, expected at most {MOST_MISSED}")
    first = int(counted[0])
    seen = round(stamps_s[0] / period_s)
    if abs(stamps_s[0]) * LARGEST_DRIFT < period_s / 4:  # so early that drift cannot hide a whole pulse
        first = max(0, seen)
    return first + np.r_[0, np.cumsum(steps)].astype(np.int64)


def _fit(
    pulses: NDArray[np.int64], stamps_s: NDArray[np.float64], scale_s: tuple[float, float], sent: int
) -> ClockEstimate:
    """Fit error = offset + drift * time to the stamps near the line; `scale_s`: the period, the middle of the clip."""
    period_s, middle_s = scale_s
    rig_s = pulses.astype(np.float64) * period_s
    error_s = stamps_s - rig_s
    near = _near_the_line(rig_s, error_s)
    missed = np.setdiff1d(np.arange(sent), pulses)
    named = {
        "pulses": len(pulses),
        "missed_pulses": tuple(missed.tolist()),
        "outlying_pulses": tuple(pulses[~near].tolist()),
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
    return ClockEstimate(*error_at(middle_s), *error_at(0.0), drift * 1e6, drift_sd, jitter, **named)


def _near_the_line(rig_s: NDArray[np.float64], error_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Stamps [N] within a few robust standard deviations of the median line."""
    half = len(rig_s) // 2
    if half == 0:
        return np.ones(len(rig_s), dtype=bool)
    steps = rig_s[half:] - rig_s[: len(rig_s) - half]
    rises = error_s[half:] - error_s[: len(rig_s) - half]
    slope = np.median(rises[steps > 0] / steps[steps > 0]) if (steps > 0).any() else 0.0
    residuals = error_s - slope * rig_s
    residuals = np.abs(residuals - np.median(residuals))
    return residuals <= _FAR * max(1.4826 * float(np.median(residuals)), _FINEST_S)
