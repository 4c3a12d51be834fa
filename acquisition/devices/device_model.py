"""One simulated camera below the driver: its descriptors, its registers, the blocks it sends and how it fails."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from acquisition.devices import descriptors
from acquisition.devices.device_clock import DeviceClock
from acquisition.devices.protocol import NO_PULSE, Block, BlockStatus, encode_block
from acquisition.devices.registers import (
    PROTOCOL_VERSION,
    REGISTER_BYTES,
    STREAM_ENDPOINT,
    Geometry,
    Identity,
    Request,
    State,
    Status,
    encode_tick_rate,
)
from acquisition.spikes.source import PlaneSource

STRINGS = ("", "spike4dgs", "simulated spike camera")
_FIRMWARE_VERSION = 1
_BLOCK_PLANES, _BLOCK_BYTES = 80, 1_000_000
_POLL_S = 0.002
_IN, _KIND, _VENDOR = 0x80, 0x60, 0x40
_GET_DESCRIPTOR, _CLEAR_FEATURE, _TO_ENDPOINT = 0x06, 0x01, 0x02


class StallError(Exception):
    """The device refuses a request, or its pipe is halted."""


@dataclass(frozen=True)
class Pace:
    """Planes come at the tick rate whether they are fetched or not: `clock` counts seconds.

    Of more than `memory_planes` that wait, the oldest are thrown away.
    """

    memory_planes: int
    clock: Callable[[], float] = time.monotonic


class DeviceModel:
    """A camera whose light comes from `source`, which is asked for planes only as fast as the host reads.

    With a `pace` it does not wait for the host. Armed, it waits for `trigger` (the shared line) or the START request;
    `sync_period_s` is the time between the line's pulses from then on, 0 where the trigger is the only one.
    """

    def __init__(
        self,
        serial: str,
        source: PlaneSource,
        tick_rate_hz: float,
        clock: DeviceClock | None = None,
        pace: Pace | None = None,
    ):
        layout = source.layout
        self.serial = serial
        self.tick_rate_hz = tick_rate_hz
        self.geometry = Geometry(layout, max(1, min(_BLOCK_PLANES, _BLOCK_BYTES // layout.plane_bytes)))
        self.sync_period_s = 0.0
        self._clock, self._pace = clock or DeviceClock(), pace
        self._source = source
        self._changed = threading.Condition()
        self._state = State.IDLE
        self._halted = False
        self._held_after: int | None = None
        self._to_flip: list[int] = []
        self._reset_run()

    @property
    def state(self) -> State:
        """What the camera is doing."""
        return self._state

    def string_descriptor(self, number: int) -> bytes:
        """String `number`; 0 lists the languages. Raises StallError for one that does not exist."""
        strings = (*STRINGS, self.serial)
        if not 0 <= number < len(strings):
            raise StallError
        return descriptors.encode_string(number, strings)

    def control(self, kind: int, request: int, value: int, index: int, data: bytes = b"") -> bytes:
        """Answer a request by the fields of its setup packet; raises StallError for one it does not know."""
        if kind & _KIND == _VENDOR:
            if kind & _IN:
                return self.read_register(request)
            self.command(request)
            return b""
        if (kind, request, value, index) == (_TO_ENDPOINT, _CLEAR_FEATURE, 0, STREAM_ENDPOINT):
            self.clear_halt()
            return b""
        if kind == _IN and request == _GET_DESCRIPTOR:
            return self._descriptor(value >> 8, value & 0xFF)
        raise StallError

    def read_register(self, request: int) -> bytes:
        """Answer a vendor IN request; raises StallError for an unknown register."""
        if request not in REGISTER_BYTES:
            raise StallError
        if request == Request.IDENTITY:
            return Identity(PROTOCOL_VERSION, _FIRMWARE_VERSION).encode()
        if request == Request.GEOMETRY:
            return self.geometry.encode()
        if request == Request.TICK_RATE:
            return encode_tick_rate(self.tick_rate_hz)
        return Status(self._state, self._sync_pulses, self._emitted_planes, self._dropped_planes).encode()

    def command(self, request: int) -> None:
        """Obey a vendor OUT request; raises StallError for an unknown one, or START when not armed."""
        with self._changed:
            if request == Request.ARM:
                self._state = State.ARMED
                self._reset_run()
            elif request == Request.START and self._state is State.ARMED:
                self._run()
            elif request == Request.STOP:
                self._state = State.IDLE
                self._outgoing = memoryview(b"")
            else:
                raise StallError
            self._changed.notify_all()

    def trigger(self) -> None:
        """A pulse on the shared line: it starts an armed camera and is counted by every one."""
        with self._changed:
            self._sync_pulses += 1
            self._pulse_ns = self._device_time_ns()
            if self._state is State.ARMED:
                self._pulse_ns = round(self._clock.latch_s(1, 0) * 1e9)
                self._run()
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
        size = size if self._held_after is None else min(size, self._held_after)
        taken, self._outgoing = self._outgoing[:size], self._outgoing[size:]
        if self._held_after is not None:
            self._held_after -= len(taken)
        return taken

    def _reset_run(self) -> None:
        self._sync_pulses = self._emitted_blocks = self._emitted_planes = self._dropped_planes = 0
        self._pulse_ns: int | None = None
        self._outgoing = memoryview(b"")

    def _run(self) -> None:
        self._state = State.RUNNING
        self._started_s = self._pace.clock() if self._pace else 0.0

    def _device_time_ns(self) -> int:
        return round((self._emitted_planes / self.tick_rate_hz + self._clock.offset_s) * 1e9)

    def _descriptor(self, kind: int, number: int) -> bytes:
        if kind == descriptors.STRING:
            return self.string_descriptor(number)
        encoded = {
            descriptors.DEVICE: descriptors.encode_fields(descriptors.CAMERA_DEVICE),
            descriptors.CONFIGURATION: descriptors.CAMERA_CONFIGURATION_BYTES,
            descriptors.BOS: descriptors.SUPER_SPEED_BOS,
        }
        if kind not in encoded:
            raise StallError
        return encoded[kind]

    def _next_block(self) -> bytes:
        count = self.geometry.planes_per_block
        status = BlockStatus(0)
        if self._pace:
            due = int((self._pace.clock() - self._started_s) * self.tick_rate_hz) - self._emitted_planes
            lost = (
                len(self._source.next_planes(due - self._pace.memory_planes)) if due > self._pace.memory_planes else 0
            )
            self._dropped_planes += lost
            self._emitted_planes += lost
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
        self._emitted_planes += len(packed)
        return self._damaged(encode_block(block))

    def _count_pulses(self) -> None:
        """Count the pulses of the train that began with the trigger."""
        if self._pulse_ns is not None and self.sync_period_s > 0:
            time_s = self._emitted_planes / self.tick_rate_hz + self._clock.offset_s
            self._sync_pulses, latch_s = self._clock.seen(time_s, self.sync_period_s)
            self._pulse_ns = None if latch_s is None else round(latch_s * 1e9)

    def _damaged(self, data: bytes) -> bytes:
        if not self._to_flip:
            return data
        damaged = bytearray(data)
        for byte in self._to_flip:
            damaged[byte] ^= 16
        self._to_flip.clear()
        return bytes(damaged)
