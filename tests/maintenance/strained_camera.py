"""A simulated camera that tests strain: its clock drifts, its time does not wait for the host, its stream breaks."""

import math
from dataclasses import replace

from maintenance.device_clock import DeviceClock, Pace

from acquisition.devices.device_model import DeviceModel
from acquisition.devices.device_run import DeviceRun
from acquisition.devices.device_stream import DeviceStream
from acquisition.devices.mock import MockBackend, Port
from acquisition.devices.profile import Profile
from acquisition.devices.profiles.direct import DIRECT
from acquisition.devices.protocol import BlockParser, BlockStatus, encode_block
from acquisition.devices.registers import ClockRegister, State, Status

_POLL_S = 0.002


class StrainedRun(DeviceRun):
    """A run by `clock`; with a `pace`, in real time: armed while the line pulses, it starts at the next pulse."""

    def __init__(self, tick_rate_hz: float, clock: DeviceClock, pace: Pace | None):
        self.clock, self.pace = clock, pace
        self._train_s: float | None = None
        super().__init__(tick_rate_hz, *([pace.clock] if pace else []))
        self.offset_s = clock.offset_s

    def obey(self, request: int) -> None:
        super().obey(request)
        if self.state is State.ARMED:
            self._armed_s = self.now_s()

    def trigger(self) -> None:
        super().trigger()
        if self.hears:
            self._train_s = self.started_s if self.state is State.RUNNING else self.now_s()

    def join_pulses(self) -> None:
        """Start at the first pulse after the camera was armed, where that has come."""
        with self.changed:
            if self.state is not State.ARMED or self._train_s is None or not self.pace or self.sync_period_s <= 0:
                return
            gone = math.floor((self._armed_s - self._train_s) / self.sync_period_s)
            pulse_s = self._train_s + (gone + 1) * self.sync_period_s
            if self.now_s() >= pulse_s:
                self.sync_pulses, self._pulse_ns = 1, self.device_time_ns()
                self._start(pulse_s)

    def count_pulses(self) -> None:
        if self._pulse_ns is not None and self.sync_period_s > 0:
            time_s = self.emitted_planes / self.tick_rate_hz + self.clock.offset_s
            self.sync_pulses, latch_s = self.clock.seen(time_s, self.sync_period_s)
            self._pulse_ns = None if latch_s is None else round(latch_s * 1e9)

    def status(self) -> Status:
        self.join_pulses()
        return super().status()

    def clock_register(self) -> ClockRegister:
        self.join_pulses()
        return super().clock_register()

    def _oscillator_ns(self, at_s: float) -> int:
        return round((at_s - self._powered_s) * (1e9 + self.clock.drift_ppm * 1e3))


class StrainedStream(DeviceStream):
    """A stream that breaks.

    After `hangs_after` bytes more the camera sends nothing, in the middle of whatever it is. Of each byte in `flipped`
    of the next block a bit is damaged. A paced camera throws planes away that were not fetched in time.
    """

    def __init__(self, run: StrainedRun, source):
        super().__init__(run, source)
        self.hangs_after: int | None = None
        self.flipped: list[int] = []

    def send(self, size: int, timeout_s: float) -> memoryview:
        run = self._run
        run.join_pulses()
        if self.hangs_after == 0 and not self.halted:
            with run.changed:
                run.changed.wait(timeout_s)
        if self.hangs_after == 0 and not self.halted:
            return memoryview(b"")
        wanted = size if self.hangs_after is None else min(size, self.hangs_after)
        taken = super().send(wanted, min(timeout_s, _POLL_S) if run.pace else timeout_s)
        if self.hangs_after is not None:
            self.hangs_after -= len(taken)
        return taken

    def next_block(self) -> bytes:
        lost, run = 0, self._run
        if run.pace:
            due = int((run.now_s() - run.started_s) * run.tick_rate_hz) - run.emitted_planes
            late = due - run.pace.memory_planes
            lost = len(self.source.next_planes(late)) if late > 0 else 0
            run.dropped_planes += lost
            run.emitted_planes += lost
            run.link = replace(run.link, overruns=run.link.overruns + (lost > 0))
            if due - lost < self.geometry.planes_per_block:
                return b""
        block = super().next_block()
        if block and lost:
            parser = BlockParser()
            parser.feed(block)
            found = parser.next()
            assert found
            status = found.status | BlockStatus.OVERRUN | BlockStatus.DISCARDED
            block = encode_block(replace(found, status=status))
        damaged = bytearray(block)
        while block and self.flipped:
            damaged[self.flipped.pop()] ^= 16
        return bytes(damaged)


class StrainedModel(DeviceModel):
    """A camera with a clock of its own, which with a `pace` does not wait for the host."""

    def __init__(
        self,
        serial: str,
        source,
        tick_rate_hz: float,
        clock: DeviceClock | None = None,
        pace: Pace | None = None,
        profile: Profile = DIRECT,
    ):
        super().__init__(serial, source, tick_rate_hz, profile)
        self.run = StrainedRun(tick_rate_hz, clock or DeviceClock(), pace)
        self.stream = StrainedStream(self.run, source)

    def power_up(self) -> None:
        with self.run.changed:
            self.stream.hangs_after = None
            super().power_up()


def replug(backend: MockBackend, serial: str) -> None:
    """Pull the cable of camera `serial` and put it back; it is a new device, at a new address."""
    for number, port in enumerate(backend._ports):
        if port.model.serial == serial:
            port.plugged = False
            port.model.power_up()
            backend._ports[number] = Port(port.model, 1 + max(each.address for each in backend._ports))
