"""The registers of a camera, and their requests; PROTOCOL.md says what their bytes mean."""

from __future__ import annotations

import enum
import struct
from typing import NamedTuple

from acquisition.errors import DeviceError
from acquisition.spikes.layout import BitOrder, PlaneLayout, RowOrder

PROTOCOL_VERSION = 3
IDENTITY_MAGIC = b"S4CM"
_PIXEL_FORMATS: dict[tuple[BitOrder, RowOrder], int] = {
    ("lsb", "bottom"): 0x10,
    ("msb", "bottom"): 0x11,
    ("lsb", "top"): 0x12,
    ("msb", "top"): 0x13,
}
LAYOUT_ORDERS = {code: orders for orders, code in _PIXEL_FORMATS.items()}
THRESHOLDS, EXPOSURES = (250, 4000), (1, 1000)  # thousandths


class Request(enum.IntEnum):
    """What a camera is asked: below 10 a register is read, from 10 on something is done."""

    IDENTITY = 0x01
    GEOMETRY = 0x02
    TICK_RATE = 0x03
    STATUS = 0x04
    SENSITIVITY = 0x05
    CLOCK = 0x06
    LINK = 0x07
    ARM = 0x10
    START = 0x11
    STOP = 0x12
    SET_SENSITIVITY = 0x13


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
            raise DeviceError(f"found the identity {magic!r}", f"{IDENTITY_MAGIC!r}", "this is no spike camera of ours")
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
            raise DeviceError(f"found the state {state}", f"one of {list(map(int, State))}")
        return cls(State(state), *counters)


class Sensitivity(NamedTuple):
    """Register SENSITIVITY, 8 B: the charge at which a pixel fires and the part of a tick in which it gathers light.

    Both are in thousandths, of the nominal threshold and of the tick. Check with `refuse_wild`.
    """

    threshold: int = 1000
    exposure: int = 1000

    @property
    def gain(self) -> float:
        """Spikes for the same light, as a share of those at the nominal values."""
        return self.exposure / self.threshold

    def refuse_wild(self) -> None:
        """Raise DeviceError for values no camera takes."""
        for name, value, (least, most) in (
            ("threshold", self.threshold, THRESHOLDS),
            ("exposure", self.exposure, EXPOSURES),
        ):
            if not least <= value <= most:
                raise DeviceError(f"found the {name} {value}", f"{least} to {most} thousandths")

    def encode(self) -> bytes:
        """The register's bytes."""
        return _SENSITIVITY.pack(*self)

    @classmethod
    def decode(cls, data: bytes) -> Sensitivity:
        """Raises DeviceError for bytes that are not this register."""
        found = cls(*_unpack(_SENSITIVITY, data, "sensitivity"))
        found.refuse_wild()
        return found


class ClockRegister(NamedTuple):
    """Register CLOCK, 16 B: the oscillator that counts the ticks, in ns since power-up, when the request came.

    `trigger_ns` is what it showed at the trigger of the run, None where the camera does not run.
    """

    now_ns: int
    trigger_ns: int | None

    def encode(self) -> bytes:
        """The register's bytes."""
        return _CLOCK.pack(self.now_ns, _NO_TRIGGER if self.trigger_ns is None else self.trigger_ns)

    @classmethod
    def decode(cls, data: bytes) -> ClockRegister:
        """Raises DeviceError for bytes that are not this register."""
        now_ns, trigger_ns = _unpack(_CLOCK, data, "clock")
        return cls(now_ns, None if trigger_ns == _NO_TRIGGER else trigger_ns)


class LinkCounters(NamedTuple):
    """Register LINK, 24 B, since power-up: packets sent again, times the link was trained anew, memory overruns."""

    errors: int = 0
    recoveries: int = 0
    overruns: int = 0

    def since(self, before: LinkCounters) -> LinkCounters:
        """What came after `before`; all of it where the camera has been powered up anew."""
        if any(now < then for now, then in zip(self, before, strict=True)):
            return self
        return LinkCounters(*(now - then for now, then in zip(self, before, strict=True)))

    def encode(self) -> bytes:
        """The register's bytes."""
        return _LINK.pack(*self)

    @classmethod
    def decode(cls, data: bytes) -> LinkCounters:
        """Raises DeviceError for bytes that are not this register."""
        return cls(*_unpack(_LINK, data, "link"))


_IDENTITY = struct.Struct("<4sHH")
_GEOMETRY = struct.Struct("<HHII")
_STATUS = struct.Struct("<QQQQ")
_TICK_RATE = struct.Struct("<Q")
_SENSITIVITY = struct.Struct("<II")
_CLOCK = struct.Struct("<QQ")
_LINK = struct.Struct("<QQQ")
_NO_TRIGGER = (1 << 64) - 1
REGISTER_BYTES = {
    Request.IDENTITY: 8,
    Request.GEOMETRY: 12,
    Request.TICK_RATE: 8,
    Request.STATUS: 32,
    Request.SENSITIVITY: 8,
    Request.CLOCK: 16,
    Request.LINK: 24,
}


def encode_tick_rate(tick_rate_hz: float) -> bytes:
    """Register TICK_RATE: 8 B, in millihertz."""
    return _TICK_RATE.pack(round(tick_rate_hz * 1000))


def decode_tick_rate(data: bytes) -> float:
    """The tick rate in Hz."""
    return _unpack(_TICK_RATE, data, "tick rate")[0] / 1000


def pixel_format(layout: PlaneLayout) -> int:
    """The code of one-bit pixels in this bit and row order.

    Raises DeviceError for columns behind the pixels, which no format has.
    """
    if layout.trailing_columns:
        found = f"found {layout.trailing_columns} columns behind the pixels"
        raise DeviceError(f"{found}", "none", "send planes of pixels only")
    return _PIXEL_FORMATS[layout.bit_order, layout.row_order]


def layout_of(width: int, height: int, code: int) -> PlaneLayout:
    """The layout a size and a pixel format name; raises DeviceError for a format this protocol does not have."""
    if code not in LAYOUT_ORDERS:
        raise DeviceError(f"found the pixel format {code:#x}", f"one of {sorted(map(hex, LAYOUT_ORDERS))}")
    bit_order, row_order = LAYOUT_ORDERS[code]
    return PlaneLayout(width, height, bit_order, row_order)


def _unpack(register: struct.Struct, data: bytes, name: str) -> tuple:
    if len(data) != register.size:
        raise DeviceError(f"found {len(data)} B in the {name} register", f"{register.size}")
    return register.unpack(data)
