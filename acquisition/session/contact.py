"""What a camera says of itself beside its stream, and the way back to one that was lost.

A camera that comes back counts planes and time from its new trigger. Where that lies on the rig clock follows from its
clock, latched against the host's before and after: r = run before + host time between - run after. With a line that
pulses, the trigger is one of the pulses, and r is rounded to it; that is exact as long as r is known to half a period.
"""

from __future__ import annotations

import contextlib
import dataclasses
import threading
from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

from acquisition.devices.registers import Identity, LinkCounters, Sensitivity
from acquisition.devices.usb import ClockLatch
from acquisition.errors import DeviceError
from acquisition.recording.manifest import Trigger

LOOK_BLOCKS = 64  # between two looks: a quarter of a second at the lab rig's rate
CLOCK_SPREAD = 1e-4  # by how much a camera's clock and the host's may differ
MOST_RETURNS = 20  # of one camera in a run; one that is lost more often has a bad cable
_POLL_S = 0.05


@runtime_checkable
class AskedCamera(Protocol):
    """A camera that answers beside its stream; `acquisition.devices.usb.UsbCamera` is one."""

    serial: str

    def identity(self) -> Identity:
        """The protocol and firmware it runs."""
        ...

    def sensitivity(self) -> Sensitivity:
        """The threshold and the exposure."""
        ...

    def link_counters(self) -> LinkCounters:
        """What its end of the link has counted since it was powered up."""
        ...

    def latch(self) -> ClockLatch:
        """Its clock against the host's."""
        ...

    def reset(self) -> None:
        """Reset it by the host's port."""
        ...

    def reopen(self) -> None:
        """Find it on the bus again."""
        ...

    def arm(self, *, joins: bool = False) -> None:
        """Get ready for the trigger; `joins`: it may have come already, from a line that pulses."""
        ...

    def start(self) -> None:
        """Start without a trigger line."""
        ...


@dataclasses.dataclass(frozen=True)
class Recovery:
    """For how long a camera that was lost is looked for, 0 for not at all, and what starts it again.

    `period_s` is the time between the line's pulses, None where it does not pulse; `clock` counts the host's seconds,
    as `AskedCamera.latch` does.
    """

    seconds: float
    clock: Callable[[], float]
    trigger: Trigger
    period_s: float | None


class Return(NamedTuple):
    """A camera's new plane 0 is `run_s` after the run's trigger, right to `uncertainty_s`; 0: on a pulse."""

    run_s: float
    uncertainty_s: float


class Contact:
    """What one camera has said since the run was armed."""

    def __init__(self, camera: AskedCamera):
        self.away = False
        self.returns: list[Return] = []
        self._camera = camera
        self._before = self._now = LinkCounters()
        self._latches: list[ClockLatch] = []  # the first and the last
        self._run: ClockLatch | None = None  # the last one of the run that the planes are counted from
        self._blocks = 0

    def begin(self) -> None:
        """Ask what it is, before it is armed; raises DeviceError."""
        identity, self._sensitivity = self._camera.identity(), self._camera.sensitivity()
        self._firmware = identity.firmware_version
        self._before = self._now = self._camera.link_counters()

    @property
    def link(self) -> LinkCounters:
        """What the link has counted since `begin`."""
        return self._now.since(self._before)

    def count_block(self) -> None:
        """A block came; now and then the camera is asked how it is. Where it does not answer, the stream will tell."""
        if self._blocks % LOOK_BLOCKS == 0:
            with contextlib.suppress(DeviceError):
                self._look()
        self._blocks += 1

    def run_s(self, host_s: float) -> float | None:
        """Seconds since the run's trigger at the host's `host_s`, None where the camera's clock was never latched."""
        return None if self._run is None or self._run.run_s is None else self._run.run_s + host_s - self._run.host_s

    def find_again(self, how: Recovery, stop: threading.Event, is_over: Callable[[], bool]) -> Return | None:
        """Reset the camera, wait for it, arm and start it; None where that is not to be, or not in time."""
        if self._run is None or len(self.returns) >= MOST_RETURNS:
            return None
        self.away, self._blocks = True, 0
        until_s = how.clock() + how.seconds
        with contextlib.suppress(DeviceError):
            self._camera.reset()
        while not stop.is_set() and not is_over() and how.clock() < until_s:
            try:
                self._camera.reopen()
                found = self._start(how, stop, until_s)
            except DeviceError:
                found = None
            if found:
                self.away = False
                self.returns.append(found)
                return found
            stop.wait(_POLL_S)
        return None

    def to_json(self) -> dict[str, object]:
        """What the manifest says of the camera."""
        first, last = (self._latches[0], self._latches[-1]) if self._latches else (None, None)
        return {
            "serial": self._camera.serial,
            "firmware": self._firmware,
            "sensitivity": self._sensitivity._asdict(),
            "link": self.link._asdict(),
            "first_latch": first and first._asdict(),
            "last_latch": last and last._asdict(),
            "returns": [each._asdict() for each in self.returns],
        }

    def _look(self) -> None:
        self._now = self._camera.link_counters()
        latch = self._camera.latch()
        self._latches = [*self._latches[:1], latch]
        if latch.run_s is not None and not self.returns:
            self._run = latch

    def _start(self, how: Recovery, stop: threading.Event, until_s: float) -> Return | None:
        """The camera's new trigger; raises DeviceError, and gives None where none came."""
        self._camera.arm(joins=how.period_s is not None)
        if how.period_s is None:
            self._camera.start()
        while (latch := self._camera.latch()).run_s is None:
            if stop.wait(_POLL_S) or how.clock() >= until_s:
                return None
        before_s = self.run_s(latch.host_s)
        if before_s is None or self._run is None:
            return None
        begin_s, apart_s = before_s - latch.run_s, latch.host_s - self._run.host_s
        uncertainty_s = self._run.uncertainty_s + latch.uncertainty_s + CLOCK_SPREAD * apart_s
        if how.period_s is None:
            return Return(begin_s, uncertainty_s)
        exact = uncertainty_s < how.period_s / 2
        return Return(round(begin_s / how.period_s) * how.period_s, 0.0 if exact else uncertainty_s)
