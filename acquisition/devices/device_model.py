"""One simulated camera below the driver: its descriptors, its registers, the blocks it sends and how it fails."""

from __future__ import annotations

import math
import operator
import threading
import time

from acquisition.devices import descriptors
from acquisition.devices.control_channel import MessageEnd, StallError
from acquisition.devices.device_clock import DeviceClock, Pace
from acquisition.devices.profile import Profile
from acquisition.devices.profiles.direct import DIRECT
from acquisition.devices.protocol import NO_PULSE, Block, BlockStatus, encode_block
from acquisition.devices.registers import (
    PROTOCOL_VERSION,
    REGISTER_BYTES,
    ClockRegister,
    Geometry,
    Identity,
    LinkCounters,
    Request,
    Sensitivity,
    State,
    Status,
    encode_tick_rate,
)
from acquisition.errors import DeviceError
from acquisition.spikes.source import Adjustable, PlaneSource

STRINGS = ("", "spike4dgs", "simulated spike camera")
_BLOCK_PLANES, _BLOCK_BYTES = 80, 1_000_000
_POLL_S = 0.002
_IN, _KIND, _VENDOR = 0x80, 0x60, 0x40
_GET_DESCRIPTOR, _CLEAR_FEATURE, _TO_ENDPOINT = 0x06, 0x01, 0x02


class DeviceModel:
    """A camera whose light comes from `source`, which is asked for planes only as fast as the host reads.

    With a `pace` it does not wait for the host. Armed, it waits for `trigger` (the shared line) or the START request;
    `sync_period_s` is the time between the line's pulses from then on, 0 where the trigger is the only one. A paced one
    that is armed while the line pulses starts at the next pulse. `link` is what its LINK register shows, to which each
    block adds `link_per_block`; unless it `hears` the line, it starts by request only.
    """

    def __init__(
        self,
        serial: str,
        source: PlaneSource,
        tick_rate_hz: float,
        clock: DeviceClock | None = None,
        pace: Pace | None = None,
        profile: Profile = DIRECT,
    ):
        layout = source.layout
        self.serial = serial
        self.profile, self.stream_endpoint = profile, profile.stream_endpoint
        self.sensitivity, self.firmware_version = Sensitivity(), 1
        self.tick_rate_hz = tick_rate_hz
        self.geometry = Geometry(layout, max(1, min(_BLOCK_PLANES, _BLOCK_BYTES // layout.plane_bytes)))
        self.sync_period_s = 0.0
        self.clock, self._pace, self.hears, self.link_per_block = clock or DeviceClock(), pace, True, LinkCounters()
        self.now_s = pace.clock if pace else time.monotonic
        self._source = source
        self._changed = threading.Condition()
        self._state = State.IDLE
        self._held_after: int | None
        self._to_flip: list[int] = []
        self._messages = MessageEnd(self.read_register, self._write)
        self._train_s: float | None = None
        self.power_up()

    @property
    def state(self) -> State:
        """What the camera is doing."""
        return self._state

    def power_up(self) -> None:
        """Begin anew, as after a reset or with its cable pulled: idle, all counters at zero; the light goes on."""
        with self._changed:
            self._state, self._halted, self._held_after = State.IDLE, False, None
            self.link = LinkCounters()
            self._powered_s = self.now_s()
            self._reset_run()

    def control(self, kind: int, request: int, value: int, index: int, data: bytes = b"") -> bytes:
        """Answer a request by the fields of its setup packet; raises StallError for one it does not know."""
        if kind & _KIND == _VENDOR and not self.profile.command_endpoint:
            if kind & _IN:
                return self.read_register(request)
            self._write(request, data)
            return b""
        if (kind, request, value, index) == (_TO_ENDPOINT, _CLEAR_FEATURE, 0, self.stream_endpoint):
            self.clear_halt()
            return b""
        if kind == _IN and request == _GET_DESCRIPTOR:
            strings = (*STRINGS, self.serial)
            found = descriptors.descriptor(self.profile, strings, value >> 8, value & 0xFF)
            if found is not None:
                return found
        raise StallError

    def take(self, endpoint: int, data: bytes) -> None:
        """Bytes to a bulk pipe: commands, where the profile has a pipe for them. Raises StallError for any other."""
        if not endpoint or endpoint != self.profile.command_endpoint:
            raise StallError
        self._messages.take(data)

    def give(self, endpoint: int) -> bytes:
        """The next reply to a command, empty where there is none; raises StallError for another pipe than its."""
        if not endpoint or endpoint != self.profile.reply_endpoint:
            raise StallError
        return self._messages.give()

    def read_register(self, request: int) -> bytes:
        """The bytes of a register; raises StallError for an unknown one."""
        if request not in REGISTER_BYTES:
            raise StallError
        self._join_pulses()
        if request == Request.STATUS:
            return Status(self._state, self._sync_pulses, self._emitted_planes, self._dropped_planes).encode()
        if request == Request.CLOCK:
            trigger_ns = self._oscillator_ns(self._started_s) if self._state is State.RUNNING else None
            return ClockRegister(self._oscillator_ns(self.now_s()), trigger_ns).encode()
        if request == Request.TICK_RATE:
            return encode_tick_rate(self.tick_rate_hz)
        return {
            Request.IDENTITY: Identity(PROTOCOL_VERSION, self.firmware_version),
            Request.GEOMETRY: self.geometry,
            Request.SENSITIVITY: self.sensitivity,
            Request.LINK: self.link,
        }[Request(request)].encode()

    def command(self, request: int) -> None:
        """Obey a request without data; raises StallError for an unknown one, or START when not armed."""
        with self._changed:
            if request == Request.ARM:
                self._state = State.ARMED
                self._reset_run()
                self._armed_s = self.now_s()
            elif request == Request.START and self._state is State.ARMED:
                self._run(self.now_s())
            elif request == Request.STOP:
                self._state = State.IDLE
                self._outgoing = memoryview(b"")
            else:
                raise StallError
            self._changed.notify_all()

    def trigger(self) -> None:
        """A pulse on the shared line: it starts an armed camera and is counted by every one."""
        with self._changed:
            if not self.hears:
                return
            self._train_s = self.now_s()
            self._sync_pulses += 1
            self._pulse_ns = self._device_time_ns()
            if self._state is State.ARMED:
                self._pulse_ns = round(self.clock.latch_s(1, 0) * 1e9)
                self._run(self._train_s)
            self._changed.notify_all()

    def wake(self) -> None:
        """End a waiting `stream`; what pulled the plug calls it."""
        with self._changed:
            self._changed.notify_all()

    def halt(self) -> None:
        """Stall the stream until the host clears it."""
        self._halted = True
        self.wake()

    def clear_halt(self) -> None:
        """The host ends a stall."""
        self._halted = False

    def hold(self, after_bytes: int) -> None:
        """Send `after_bytes` more and then nothing, in the middle of whatever it is, until `release`."""
        self._held_after = after_bytes

    def release(self) -> None:
        """Go on after `hold`."""
        self._held_after = None
        self.wake()

    def flip_bit(self, byte: int) -> None:
        """Damage a bit of byte `byte` of the next block on its way."""
        self._to_flip.append(byte)

    def stream(self, size: int, timeout_s: float) -> memoryview:
        """At most `size` bytes of the stream; empty when there are none within `timeout_s`. Ends with each block.

        Raises StallError while the pipe is halted.
        """
        self._join_pulses()
        if self._halted:
            raise StallError
        if self._held_after == 0 or self._state is not State.RUNNING:
            with self._changed:
                self._changed.wait(timeout_s)
            if self._halted:
                raise StallError
        if self._held_after == 0 or self._state is not State.RUNNING:
            return memoryview(b"")
        if not self._outgoing:
            block = self._next_block()
            with self._changed:
                if not block:
                    self._changed.wait(min(timeout_s, _POLL_S) if self._pace else timeout_s)
                if self._state is State.RUNNING:
                    self._outgoing = memoryview(block)
        if self._held_after is not None:
            size = min(size, self._held_after)
            self._held_after -= min(size, len(self._outgoing))
        taken, self._outgoing = self._outgoing[:size], self._outgoing[size:]
        return taken

    def _reset_run(self) -> None:
        self._sync_pulses = self._emitted_blocks = self._emitted_planes = self._dropped_planes = 0
        self._armed_s = self._started_s = 0.0
        self._pulse_ns: int | None = None
        self._outgoing = memoryview(b"")

    def _run(self, at_s: float) -> None:
        self._state = State.RUNNING
        self._started_s = at_s

    def _join_pulses(self) -> None:
        """Start at the first pulse after it was armed, where that has come: only a paced camera lives in real time."""
        with self._changed:
            if self._state is not State.ARMED or self._train_s is None or not self._pace or self.sync_period_s <= 0:
                return
            gone = math.floor((self._armed_s - self._train_s) / self.sync_period_s)
            pulse_s = self._train_s + (gone + 1) * self.sync_period_s
            if self.now_s() >= pulse_s:
                self._sync_pulses, self._pulse_ns = 1, round(self.clock.latch_s(1, 0) * 1e9)
                self._run(pulse_s)

    def _write(self, request: int, data: bytes) -> None:
        if request != Request.SET_SENSITIVITY:
            self.command(request)
            return
        try:
            wanted = Sensitivity.decode(data)
        except DeviceError as error:
            raise StallError from error
        if self._state is not State.IDLE:
            raise StallError
        self.sensitivity = wanted
        if isinstance(self._source, Adjustable):
            self._source.sensitivity = wanted.gain

    def _oscillator_ns(self, at_s: float) -> int:
        return round((at_s - self._powered_s) * (1e9 + self.clock.drift_ppm * 1e3))

    def _device_time_ns(self) -> int:
        return round((self._emitted_planes / self.tick_rate_hz + self.clock.offset_s) * 1e9)

    def _next_block(self) -> bytes:
        count, status = self.geometry.planes_per_block, BlockStatus(0)
        if self._pace:
            due = int((self._pace.clock() - self._started_s) * self.tick_rate_hz) - self._emitted_planes
            late = due - self._pace.memory_planes
            lost = len(self._source.next_planes(late)) if late > 0 else 0
            self._dropped_planes += lost
            self._emitted_planes += lost
            self.link = self.link._replace(overruns=self.link.overruns + (lost > 0))
            status = BlockStatus.OVERRUN | BlockStatus.DISCARDED if lost else status
            if due - lost < count:
                return b""
        packed = self._source.next_planes(count)
        if not len(packed):
            return b""
        self._count_pulses()
        time_ns = self._device_time_ns()
        age_ns = NO_PULSE if self._pulse_ns is None else min(NO_PULSE, max(0, time_ns - self._pulse_ns))
        status |= BlockStatus(0) if self._sync_pulses else BlockStatus.TRIGGER_MISSED
        found = self._emitted_blocks, self._emitted_planes, time_ns, self.geometry.layout, packed
        block = Block(*found, self._sync_pulses, self._dropped_planes, status, age_ns)
        self._emitted_blocks += 1
        self.link = LinkCounters(*map(operator.add, self.link, self.link_per_block))
        self._emitted_planes += len(packed)
        return self._damaged(encode_block(block))

    def _count_pulses(self) -> None:
        """Count the pulses of the train that began with the trigger."""
        if self._pulse_ns is not None and self.sync_period_s > 0:
            time_s = self._emitted_planes / self.tick_rate_hz + self.clock.offset_s
            self._sync_pulses, latch_s = self.clock.seen(time_s, self.sync_period_s)
            self._pulse_ns = None if latch_s is None else round(latch_s * 1e9)

    def _damaged(self, data: bytes) -> bytes:
        if not self._to_flip:
            return data
        damaged = bytearray(data)
        while self._to_flip:
            damaged[self._to_flip.pop()] ^= 16
        return bytes(damaged)
