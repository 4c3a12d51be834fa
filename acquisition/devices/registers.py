"""The registers of a camera, behind vendor control requests; PROTOCOL.md says what their bytes mean."""

from __future__ import annotations

import enum
import struct
from typing import NamedTuple

from acquisition.errors import DeviceError
from acquisition.spikes.layout import BitOrder, PlaneLayout, RowOrder

PROTOCOL_VERSION = 2
VENDOR_ID = 0x1209  # pid.codes, an identifier open to projects like this one
PRODUCT_ID = 0x0001
STREAM_ENDPOINT = 0x81
IDENTITY_MAGIC = b"S4CM"
_PIXEL_FORMATS: dict[tuple[BitOrder, RowOrder], int] = {
    ("lsb", "bottom"): 0x10,
    ("msb", "bottom"): 0x11,
    ("lsb", "top"): 0x12,
    ("msb", "top"): 0x13,
}
LAYOUT_ORDERS = {code: orders for orders, code in _PIXEL_FORMATS.items()}


class Request(enum.IntEnum):
    """bRequest of a vendor request to the device: the first four are read, the last three are commands."""

    IDENTITY = 0x01
    GEOMETRY = 0x02
    TICK_RATE = 0x03
    STATUS = 0x04
    ARM = 0x10
    START = 0x11
    STOP = 0x12


class State(enum.IntEnum):
    """What a camera is doing; an armed one waits for the trigger."""

    IDLE = 0
    ARMED = 1
    RUNNING = 2


class Identity(NamedTuple):
    """Register IDENTITY: 8 B."""

    protocol_version: int
    firmware_version: int

    def encode(self) -> bytes:
        """The register's bytes."""
        return _IDENTITY.pack(IDENTITY_MAGIC, *self)

    @classmethod
    def decode(cls, data: bytes) -> Identity:
        """Raises DeviceError for bytes that are not this register."""
        magic, *fields = _unpack(_IDENTITY, data, "identity")
        if magic != IDENTITY_MAGIC:
            raise DeviceError(
                f"found the identity {magic!r}, expected {IDENTITY_MAGIC!r}; this is no spike camera of ours"
            )
        return cls(*fields)


class Geometry(NamedTuple):
    """Register GEOMETRY: 12 B."""

    layout: PlaneLayout
    planes_per_block: int

    def encode(self) -> bytes:
        """The register's bytes."""
        return _GEOMETRY.pack(self.layout.width, self.layout.height, pixel_format(self.layout), self.planes_per_block)

    @classmethod
    def decode(cls, data: bytes) -> Geometry:
        """Raises DeviceError for bytes that are not this register."""
        width, height, code, planes_per_block = _unpack(_GEOMETRY, data, "geometry")
        return cls(layout_of(width, height, code), planes_per_block)


class Status(NamedTuple):
    """Register STATUS: 32 B; `dropped_planes` counts what the device itself lost since it was armed."""

    state: State
    sync_pulses: int
    emitted_planes: int
    dropped_planes: int

    def encode(self) -> bytes:
        """The register's bytes."""
        return _STATUS.pack(*self)

    @classmethod
    def decode(cls, data: bytes) -> Status:
        """Raises DeviceError for bytes that are not this register."""
        state, *counters = _unpack(_STATUS, data, "status")
        if state not in list(State):
            raise DeviceError(f"found the state {state}, expected one of {list(map(int, State))}")
        return cls(State(state), *counters)


_IDENTITY = struct.Struct("<4sHH")
_GEOMETRY = struct.Struct("<HHII")
_STATUS = struct.Struct("<QQQQ")
_TICK_RATE = struct.Struct("<Q")
REGISTER_BYTES = {Request.IDENTITY: 8, Request.GEOMETRY: 12, Request.TICK_RATE: 8, Request.STATUS: 32}


def encode_tick_rate(tick_rate_hz: float) -> bytes:
    """Register TICK_RATE: 8 B, in millihertz."""
    return _TICK_RATE.pack(round(tick_rate_hz * 1000))


def decode_tick_rate(data: bytes) -> float:
    """The tick rate in Hz."""
    return _unpack(_TICK_RATE, data, "tick rate")[0] / 1000


def pixel_format(layout: PlaneLayout) -> int:
    """The code of one-bit pixels in this bit and row order."""
    return _PIXEL_FORMATS[layout.bit_order, layout.row_order]


def layout_of(width: int, height: int, code: int) -> PlaneLayout:
    """The layout a size and a pixel format name; raises DeviceError for a format this protocol does not have."""
    if code not in LAYOUT_ORDERS:
        raise DeviceError(f"found the pixel format {code:#x}, expected one of {sorted(map(hex, LAYOUT_ORDERS))}")
    bit_order, row_order = LAYOUT_ORDERS[code]
    return PlaneLayout(width, height, bit_order, row_order)


def _unpack(register: struct.Struct, data: bytes, name: str) -> tuple:
    if len(data) != register.size:
        raise DeviceError(f"found {len(data)} B in the {name} register, expected {register.size}")
    return register.unpack(data)
