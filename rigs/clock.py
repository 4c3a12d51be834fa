"""The rig clock: plane k integrates light over [k, k + 1) / rate; its image is the instant (k + 0.5) / rate."""

import math
from dataclasses import dataclass

from rigs.errors import RigError


@dataclass(frozen=True)
class RigClock:
    """Converts planes to seconds and back; zero is the first recorded plane of the trigger.

    `first_tick` is the tick of plane 0: the planes at hand may be a part of those recorded.
    """

    tick_rate_hz: float
    first_tick: int = 0

    def __post_init__(self) -> None:
        if not math.isfinite(self.tick_rate_hz) or self.tick_rate_hz <= 0:
            raise RigError(f"found the tick rate {self.tick_rate_hz} Hz", "a positive number")

    def instant_s(self, plane: float) -> float:
        """Return the middle of plane `plane`, in seconds."""
        return (self.first_tick + plane + 0.5) / self.tick_rate_hz

    def begins_s(self, plane: float) -> float:
        """Return the instant at which the exposure of plane `plane` begins, in seconds."""
        return (self.first_tick + plane) / self.tick_rate_hz

    def plane(self, instant_s: float) -> int:
        """Return the plane whose exposure holds `instant_s`."""
        ticks = instant_s * self.tick_rate_hz
        tick = math.floor(ticks + max(1e-9, 2 * math.ulp(ticks)))  # an edge belongs to the plane that begins there
        return tick - self.first_tick
