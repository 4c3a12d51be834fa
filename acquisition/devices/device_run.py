"""One run of a simulated camera: its state, what it has counted, and what its clock shows."""

import math
import threading
import time
from collections.abc import Callable

from acquisition.devices.control_channel import StallError
from acquisition.devices.protocol import NO_PULSE
from acquisition.devices.registers import ClockRegister, LinkCounters, Request, State, Status


class DeviceRun:
    """The state of a camera that was armed, started by the shared line or by request, and stopped again.

    `sync_period_s` is the time between the line's pulses, 0 where the trigger is the only one. Unless it `hears` the
    line, it starts by request only. Its clock shows `offset_s` at the trigger; `now_s` counts its oscillator's seconds.
    `changed` is notified when the state changes.
    """

    def __init__(self, tick_rate_hz: float, now_s: Callable[[], float] = time.monotonic):
        self.tick_rate_hz, self.now_s = tick_rate_hz, now_s
        self.hears, self.offset_s, self.sync_period_s = True, 0.0, 0.0
        self.changed = threading.Condition()
        self.power_up()

    def power_up(self) -> None:
        """Begin anew, as after a reset or with the cable pulled: idle, all counters at zero."""
        with self.changed:
            self.state, self.link = State.IDLE, LinkCounters()
            self._powered_s = self.now_s()
            self._forget()

    def obey(self, request: int) -> None:
        """Change the state as asked; raises StallError for an unknown request, or START when not armed."""
        with self.changed:
            if request == Request.ARM:
                self.state = State.ARMED
                self._forget()
            elif request == Request.START and self.state is State.ARMED:
                self._start(self.now_s())
            elif request == Request.STOP:
                self.state = State.IDLE
            else:
                raise StallError
            self.changed.notify_all()

    def trigger(self) -> None:
        """Take a pulse of the shared line, which starts an armed camera and is counted by every one that hears it."""
        with self.changed:
            if not self.hears:
                return
            self.sync_pulses += 1
            self._pulse_ns = self.device_time_ns()
            if self.state is State.ARMED:
                self._start(self.now_s())
            self.changed.notify_all()

    def wake(self) -> None:
        """End any waiting for a change."""
        with self.changed:
            self.changed.notify_all()

    def count_pulses(self) -> None:
        """Count the pulses of the train that began with the trigger, up to the next plane."""
        if self._pulse_ns is not None and self.sync_period_s > 0:
            gone = math.floor((self.emitted_planes / self.tick_rate_hz + 1e-12) / self.sync_period_s)
            self.sync_pulses, self._pulse_ns = 1 + gone, round((self.offset_s + gone * self.sync_period_s) * 1e9)

    def device_time_ns(self) -> int:
        """Return what the camera's clock shows at the start of the next plane."""
        return round((self.emitted_planes / self.tick_rate_hz + self.offset_s) * 1e9)

    def pulse_age_ns(self) -> int:
        """Return the time from the last pulse to the start of the next plane."""
        return NO_PULSE if self._pulse_ns is None else min(NO_PULSE, max(0, self.device_time_ns() - self._pulse_ns))

    def status(self) -> Status:
        """Return the STATUS register."""
        return Status(self.state, self.sync_pulses, self.emitted_planes, self.dropped_planes)

    def clock_register(self) -> ClockRegister:
        """Return the CLOCK register, latched now."""
        trigger_ns = self._oscillator_ns(self.started_s) if self.state is State.RUNNING else None
        return ClockRegister(self._oscillator_ns(self.now_s()), trigger_ns)

    def _oscillator_ns(self, at_s: float) -> int:
        return round((at_s - self._powered_s) * 1e9)

    def _start(self, at_s: float) -> None:
        self.state, self.started_s = State.RUNNING, at_s

    def _forget(self) -> None:
        self.sync_pulses = self.emitted_blocks = self.emitted_planes = self.dropped_planes = 0
        self.started_s = 0.0
        self._pulse_ns: int | None = None
