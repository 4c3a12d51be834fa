"""The clock of a simulated camera and the pulses it sees, and whether its time waits for the host."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from acquisition.errors import DeviceError


@dataclass(frozen=True)
class Pace:
    """Planes come at the tick rate whether they are fetched or not: `clock` counts seconds.

    Of more than `memory_planes` that wait, the oldest are thrown away.
    """

    memory_planes: int
    clock: Callable[[], float] = time.monotonic


@dataclass(frozen=True)
class DeviceClock:
    """A clock that shows `offset_s` when the trigger comes and runs `drift_ppm` fast.

    Pulse n (from 1, the trigger, which is always seen) is latched with a Gaussian error of `jitter_s`, or not at all
    where n is `missed`. The same `seed` makes the same errors. The camera's planes follow its own clock.
    """

    offset_s: float = 0.0
    drift_ppm: float = 0.0
    jitter_s: float = 0.0
    missed: frozenset[int] = frozenset()
    seed: int = 0

    def __post_init__(self) -> None:
        if self.offset_s < 0 or self.jitter_s < 0 or min(self.missed, default=2) < 2:
            raise DeviceError(f"found the clock {self}", "offset and jitter from 0, missed pulses from 2")

    def latch_s(self, pulse: int, period_s: float) -> float:
        """Return the device time at which pulse `pulse` of a train of `period_s` is seen."""
        jitter_s = np.random.default_rng((self.seed, pulse)).normal(0, self.jitter_s) if self.jitter_s else 0.0
        return self.offset_s + (pulse - 1) * period_s * (1 + self.drift_ppm * 1e-6) + jitter_s

    def seen(self, device_time_s: float, period_s: float) -> tuple[int, float | None]:
        """Return how many pulses the camera has counted at `device_time_s`, and when it latched the last of them."""
        period_here_s = period_s * (1 + self.drift_ppm * 1e-6)
        pulse = 2 + math.floor((device_time_s - self.offset_s) / period_here_s)
        while pulse > 0 and (pulse in self.missed or self.latch_s(pulse, period_s) > device_time_s + 1e-12):
            pulse -= 1
        if pulse < 1:
            return 0, None
        return pulse - sum(1 for missed in self.missed if missed < pulse), self.latch_s(pulse, period_s)
