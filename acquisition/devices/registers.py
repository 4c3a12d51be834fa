"""The registers of a camera, and its requests; PROTOCOL.md says what their bytes mean."""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass
from typing import ClassVar, Self

from acquisition.errors import DeviceError
from acquisition.spikes.layout import BitOrder, PlaneLayout, RowOrder

PROTOCOL_VERSION = 3
IDENTITY_MAGIC = b"S4CM"
THRESHOLDS, EXPOSURES = (250, 4000), (1, 1000)  # least and most, in thousandths
_NO_TRIGGER = (1 << 64) - 1
_PIXEL_FORMATS: dict[tuple[BitOrder, RowOrder], int] = {
    ("lsb", "bottom"): 0x10,
    ("msb", "bottom"): 0x11,
    ("lsb", "top"): 0x12,
    ("msb", "top"): 0x13,
}
LAYOUT_ORDERS = {code: orders for orders, code in _PIXEL_FORMATS.items()}


class Request(enum.IntEnum):
    """A camera's requests: below 10 a register is read, from 10 on something is done."""

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
    """A camera's state; an armed one waits for the trigger."""

    IDLE = 0
    ARMED = 1
    RUNNING = 2


class Register:
    """A register, which the request of its name reads; a subclass is a dataclass whose fields FORMAT packs."""

    REQUEST: ClassVar[Request]
    FORMAT: ClassVar[struct.Struct]

    def encode(self) -> bytes:
        """Return the register's bytes."""
        return self.FORMAT.pack(*self._numbers())

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Return the register with these bytes; raises DeviceError for bytes that are not this register."""
        if len(data) != cls.FORMAT.size:
            name = cls.REQUEST.name.lower().replace("_", " ")
            raise DeviceError(f"found {len(data)} B in the {name} register", str(cls.FORMAT.size))
        return cls._of(*cls.FORMAT.unpack(data))

    def _numbers(self) -> tuple:
        return tuple(vars(self).values())

    @classmethod
    def _of(cls, *numbers) -> Self:
        return cls(*numbers)


@dataclass(frozen=True)
class Identity(Register):
    """The versions a camera runs."""

    REQUEST, FORMAT = Request.IDENTITY, struct.Struct("<4sHH")
    protocol_version: int
    firmware_version: int

    def _numbers(self) -> tuple:
        return IDENTITY_MAGIC, self.protocol_version, self.firmware_version

    @classmethod
    def _of(cls, *numbers) -> Self:
        magic, *versions = numbers
        if magic != IDENTITY_MAGIC:
            raise DeviceError(f"found the identity {magic!r}", f"{IDENTITY_MAGIC!r}", "this is no spike camera of ours")
        return cls(*versions)


@dataclass(frozen=True)
class Geometry(Register):
    """The layout of a camera's planes, and how many of them a block has."""

    REQUEST, FORMAT = Request.GEOMETRY, struct.Struct("<HHII")
    layout: PlaneLayout
    planes_per_block: int

    def _numbers(self) -> tuple:
        return self.layout.width, self.layout.height, pixel_format(self.layout), self.planes_per_block

    @classmethod
    def _of(cls, *numbers) -> Self:
        *size_and_format, planes_per_block = numbers
        return cls(layout_of(*size_and_format), planes_per_block)


@dataclass(frozen=True)
class TickRate(Register):
    """Planes a second, to a millihertz."""

    REQUEST, FORMAT = Request.TICK_RATE, struct.Struct("<Q")
    hz: float

    def _numbers(self) -> tuple:
        return (round(self.hz * 1000),)

    @classmethod
    def _of(cls, *numbers) -> Self:
        return cls(numbers[0] / 1000)


@dataclass(frozen=True)
class Status(Register):
    """The state, and the pulses, planes sent and planes that the device itself lost since it was armed."""

    REQUEST, FORMAT = Request.STATUS, struct.Struct("<QQQQ")
    state: State
    sync_pulses: int
    emitted_planes: int
    dropped_planes: int

    @classmethod
    def _of(cls, *numbers) -> Self:
        state, *counters = numbers
        if state not in list(State):
            raise DeviceError(f"found the state {state}", f"one of {list(map(int, State))}")
        return cls(State(state), *counters)


@dataclass(frozen=True)
class Sensitivity(Register):
    """The charge at which a pixel fires and the part of a tick in which it gathers light.

    Both are in thousandths: of the nominal threshold, and of the tick. Check with `refuse_wild`.
    """

    REQUEST, FORMAT = Request.SENSITIVITY, struct.Struct("<II")
    threshold: int = 1000
    exposure: int = 1000

    @property
    def gain(self) -> float:
        """Return the spikes for the same light, as a share of those at the nominal values."""
        return self.exposure / self.threshold

    def refuse_wild(self) -> None:
        """Raise DeviceError for values no camera takes."""
        ranges = {"threshold": THRESHOLDS, "exposure": EXPOSURES}
        for name, (least, most) in ranges.items():
            if not least <= (value := getattr(self, name)) <= most:
                raise DeviceError(f"found the {name} {value}", f"{least} to {most} thousandths")

    @classmethod
    def _of(cls, *numbers) -> Self:
        found = cls(*numbers)
        found.refuse_wild()
        return found


@dataclass(frozen=True)
class ClockRegister(Register):
    """The oscillator that counts the ticks, in ns since power-up, when the request came.

    `trigger_ns` is what it showed at the trigger of the run, None where the camera does not run.
    """

    REQUEST, FORMAT = Request.CLOCK, struct.Struct("<QQ")
    now_ns: int
    trigger_ns: int | None

    def _numbers(self) -> tuple:
        return self.now_ns, _NO_TRIGGER if self.trigger_ns is None else self.trigger_ns

    @classmethod
    def _of(cls, *numbers) -> Self:
        now_ns, trigger_ns = numbers
        return cls(now_ns, None if trigger_ns == _NO_TRIGGER else trigger_ns)


@dataclass(frozen=True)
class LinkCounters(Register):
    """Counters since power-up: packets sent again, times the link was trained anew, memory overruns."""

    REQUEST, FORMAT = Request.LINK, struct.Struct("<QQQ")
    errors: int = 0
    recoveries: int = 0
    overruns: int = 0

    def since(self, before: LinkCounters) -> LinkCounters:
        """Return what came after `before`; all of it where the camera has been powered up anew."""
        steps = [now - then for now, then in zip(self._numbers(), before._numbers(), strict=True)]
        return self if min(steps) < 0 else LinkCounters(*steps)

    def plus(self, more: LinkCounters) -> LinkCounters:
        """Return the sums of both."""
        return LinkCounters(*(one + other for one, other in zip(self._numbers(), more._numbers(), strict=True)))


REGISTER_BYTES = {
    kind.REQUEST: kind.FORMAT.size
    for kind in (Identity, Geometry, TickRate, Status, Sensitivity, ClockRegister, LinkCounters)
}


def pixel_format(layout: PlaneLayout) -> int:
    """Return the code of one-bit pixels in this bit and row order.

    Raises DeviceError for columns behind the pixels, which no format has.
    """
    if layout.trailing_columns:
        found = f"found {layout.trailing_columns} columns behind the pixels"
        raise DeviceError(found, "none", "send planes of pixels only")
    return _PIXEL_FORMATS[layout.bit_order, layout.row_order]


def layout_of(width: int, height: int, code: int) -> PlaneLayout:
    """Return the layout that a size and a pixel format name; raises DeviceError for an unknown format."""
    if code not in LAYOUT_ORDERS:
        raise DeviceError(f"found the pixel format {code:#x}", f"one of {sorted(map(hex, LAYOUT_ORDERS))}")
    return PlaneLayout(width, height, *LAYOUT_ORDERS[code])
