"""Asks a camera how it is beside its stream, and finds one that was lost.

A camera that comes back counts planes and time from its new trigger. Where that lies on the rig clock follows from its
clock, latched against the host's before and after: r = run before + host time between - run after. With a line that
pulses, the trigger is one of the pulses, and r is rounded to it; that is exact as long as r is known to half a period.
"""

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

from acquisition.devices.registers import Identity, LinkCounters, Sensitivity
from acquisition.devices.usb import ClockLatch, UsbCamera
from acquisition.errors import DeviceError

LOOK_BLOCKS = 64  # blocks between two looks: a quarter of a second at the lab rig's rate
CLOCK_SPREAD = 1e-4  # share by which a camera's clock and the host's may differ
MOST_RETURNS = 20  # returns of one camera in a run; one that is lost more often has a bad cable
_POLL_S = 0.05


@dataclass(frozen=True)
class Return:
    """A camera's new plane 0, `run_s` after the run's trigger, right to `uncertainty_s`; 0: on a pulse."""

    run_s: float
    uncertainty_s: float


class Contact:
    """Keeps what one camera has said since the run was armed, and finds it again when it is lost."""

    def __init__(self, camera: UsbCamera):
        self.away = False
        self.returns: list[Return] = []
        self._camera = camera
        self._before = self._now = LinkCounters()
        self._latches: list[ClockLatch] = []  # the first and the last
        self._run: ClockLatch | None = None  # the last one of the run that the planes are counted from
        self._blocks = 0

    def begin(self) -> None:
        """Ask the camera what it is, before it is armed; raises DeviceError."""
        read = self._camera.registers.read
        self._firmware, self._sensitivity = read(Identity).firmware_version, read(Sensitivity)
        self._before = self._now = read(LinkCounters)

    @property
    def link(self) -> LinkCounters:
        """Return what the link has counted since `begin`."""
        return self._now.since(self._before)

    def count_block(self) -> None:
        """Count a block, and now and then ask the camera how it is; where it does not answer, the stream will tell."""
        if self._blocks % LOOK_BLOCKS == 0:
            with contextlib.suppress(DeviceError):
                self._look()
        self._blocks += 1

    def run_s(self, host_s: float) -> float | None:
        """Return the seconds since the run's trigger at the host's `host_s`; None where no clock was latched."""
        return None if self._run is None or self._run.run_s is None else self._run.run_s + host_s - self._run.host_s

    def find_again(
        self, rejoin_s: float, period_s: float | None, stop: threading.Event, is_over: Callable[[], bool]
    ) -> Return | None:
        """Reset the camera, wait for it for `rejoin_s`, arm and start it; None where that is not to be, or not in time.

        `period_s` is the time between the line's pulses, None where it does not pulse.
        """
        if self._run is None or len(self.returns) >= MOST_RETURNS:
            return None
        self.away, self._blocks = True, 0
        until_s = time.monotonic() + rejoin_s
        with contextlib.suppress(DeviceError):
            self._camera.reset()
        while not stop.is_set() and not is_over() and time.monotonic() < until_s:
            try:
                self._camera.reopen()
                found = self._start(period_s, stop, until_s)
            except DeviceError:
                found = None
            if found:
                self.away = False
                self.returns.append(found)
                return found
            stop.wait(_POLL_S)
        return None

    def to_json(self) -> dict[str, object]:
        """Return what the manifest says of the camera."""
        first, last = (asdict(self._latches[0]), asdict(self._latches[-1])) if self._latches else (None, None)
        return {
            "serial": self._camera.serial,
            "firmware": self._firmware,
            "sensitivity": asdict(self._sensitivity),
            "link": asdict(self.link),
            "first_latch": first,
            "last_latch": last,
            "returns": [asdict(each) for each in self.returns],
        }

    def _look(self) -> None:
        self._now = self._camera.registers.read(LinkCounters)
        latch = self._camera.registers.latch()
        self._latches = [*self._latches[:1], latch]
        if latch.run_s is not None and not self.returns:
            self._run = latch

    def _start(self, period_s: float | None, stop: threading.Event, until_s: float) -> Return | None:
        """Arm and start the camera, and return where its new trigger lies; None where none came. Raises DeviceError."""
        self._camera.ensure_ready(joins=period_s is not None)
        if period_s is None:
            self._camera.start_acquiring()
        while (latch := self._camera.registers.latch()).run_s is None:
            if stop.wait(_POLL_S) or time.monotonic() >= until_s:
                return None
        before_s = self.run_s(latch.host_s)
        if before_s is None or self._run is None:
            return None
        begin_s, apart_s = before_s - latch.run_s, latch.host_s - self._run.host_s
        uncertainty_s = self._run.uncertainty_s + latch.uncertainty_s + CLOCK_SPREAD * apart_s
        if period_s is None:
            return Return(begin_s, uncertainty_s)
        exact = uncertainty_s < period_s / 2
        return Return(round(begin_s / period_s) * period_s, 0.0 if exact else uncertainty_s)
