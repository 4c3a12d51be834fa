"""One simulated camera below the driver: its descriptors, its registers and the blocks it sends."""

from __future__ import annotations

import struct
import threading

from acquisition.devices.protocol import (
    PRODUCT_ID,
    PROTOCOL_VERSION,
    REGISTER_BYTES,
    STREAM_ENDPOINT,
    VENDOR_ID,
    Block,
    Geometry,
    Identity,
    Request,
    State,
    Status,
    encode_block,
    encode_tick_rate,
)
from acquisition.spikes.source import PlaneSource

STRINGS = ("", "spike4dgs", "simulated spike camera")
LANGUAGE_ID = 0x0409
_FIRMWARE_VERSION = 1
_BLOCK_PLANES, _BLOCK_BYTES = 80, 1_000_000

DEVICE_DESCRIPTOR = {
    "bLength": 18,
    "bDescriptorType": 1,
    "bcdUSB": 0x0300,
    "bDeviceClass": 0xFF,
    "bDeviceSubClass": 0,
    "bDeviceProtocol": 0,
    "bMaxPacketSize0": 9,
    "idVendor": VENDOR_ID,
    "idProduct": PRODUCT_ID,
    "bcdDevice": 0x0100,
    "iManufacturer": 1,
    "iProduct": 2,
    "iSerialNumber": 3,
    "bNumConfigurations": 1,
}
CONFIGURATION_DESCRIPTOR = {
    "bLength": 9,
    "bDescriptorType": 2,
    "wTotalLength": 31,  # with a SuperSpeed companion of 6 B
    "bNumInterfaces": 1,
    "bConfigurationValue": 1,
    "iConfiguration": 0,
    "bmAttributes": 0x80,
    "bMaxPower": 112,
    "extra_descriptors": [],
}
INTERFACE_DESCRIPTOR = {
    "bLength": 9,
    "bDescriptorType": 4,
    "bInterfaceNumber": 0,
    "bAlternateSetting": 0,
    "bNumEndpoints": 1,
    "bInterfaceClass": 0xFF,
    "bInterfaceSubClass": 0,
    "bInterfaceProtocol": 0,
    "iInterface": 0,
    "extra_descriptors": [],
}
ENDPOINT_DESCRIPTOR = {
    "bLength": 7,
    "bDescriptorType": 5,
    "bEndpointAddress": STREAM_ENDPOINT,
    "bmAttributes": 2,
    "wMaxPacketSize": 1024,
    "bInterval": 0,
    "bRefresh": 0,
    "bSynchAddress": 0,
    "extra_descriptors": [6, 0x30, 15, 0, 0, 0],
}


class StallError(Exception):
    """The device refuses a request, or its pipe is halted."""


class DeviceModel:
    """A camera whose light comes from `source`, which is asked for planes only as fast as the host reads.

    Armed, it waits for `trigger` (the shared line) or the START request; its clock is zero at that tick.
    """

    def __init__(self, serial: str, source: PlaneSource, tick_rate_hz: float):
        layout = source.layout
        self.serial = serial
        self.tick_rate_hz = tick_rate_hz
        self.geometry = Geometry(layout, max(1, min(_BLOCK_PLANES, _BLOCK_BYTES // layout.plane_bytes)))
        self._source = source
        self._changed = threading.Condition()
        self._state = State.IDLE
        self._sync_pulses = 0
        self._emitted_blocks = 0
        self._emitted_planes = 0
        self._outgoing = memoryview(b"")

    @property
    def state(self) -> State:
        """What the camera is doing."""
        return self._state

    def string_descriptor(self, number: int) -> bytes:
        """String `number`; 0 lists the languages. Raises StallError for one that does not exist."""
        strings = (*STRINGS, self.serial)
        if not 0 <= number < len(strings):
            raise StallError
        body = struct.pack("<H", LANGUAGE_ID) if number == 0 else strings[number].encode("utf-16-le")
        return bytes((len(body) + 2, 3)) + body

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
        return Status(self._state, self._sync_pulses, self._emitted_planes, dropped_planes=0).encode()

    def command(self, request: int) -> None:
        """Obey a vendor OUT request; raises StallError for an unknown one, or START when not armed."""
        with self._changed:
            if request == Request.ARM:
                self._state = State.ARMED
                self._sync_pulses = self._emitted_blocks = self._emitted_planes = 0
                self._outgoing = memoryview(b"")
            elif request == Request.START and self._state is State.ARMED:
                self._state = State.RUNNING
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
            if self._state is State.ARMED:
                self._state = State.RUNNING
            self._changed.notify_all()

    def wake(self) -> None:
        """End a waiting `stream`; what pulled the plug calls it."""
        with self._changed:
            self._changed.notify_all()

    def stream(self, size: int, timeout_s: float) -> memoryview:
        """At most `size` bytes of the stream; empty when there are none within `timeout_s`. Ends with each block."""
        if not self._outgoing:
            with self._changed:
                if self._state is not State.RUNNING:
                    self._changed.wait(timeout_s)
                if self._state is not State.RUNNING:
                    return memoryview(b"")
            block = self._next_block()
            with self._changed:
                if not block:
                    self._changed.wait(timeout_s)
                if self._state is State.RUNNING:
                    self._outgoing = memoryview(block)
        taken, self._outgoing = self._outgoing[:size], self._outgoing[size:]
        return taken

    def _next_block(self) -> bytes:
        packed = self._source.next_planes(self.geometry.planes_per_block)
        if not len(packed):
            return b""
        first = self._emitted_planes
        time_ns = round(first * 1e9 / self.tick_rate_hz)
        block = Block(self._emitted_blocks, first, time_ns, self.geometry.layout, packed, self._sync_pulses)
        self._emitted_blocks += 1
        self._emitted_planes += len(packed)
        return encode_block(block)
