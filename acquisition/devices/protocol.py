"""The wire protocol of a camera: registers behind vendor control requests, and blocks of planes on a bulk pipe.

A block is a leader (64 B, little-endian), the packed planes, and a trailer (32 B). The leader's CRC32C covers the
leader; the trailer's covers the payload and the trailer, so no flipped bit goes unseen. Planes carry an index that the
device counts, so planes lost on the way are a jump of that index.

    leader   magic "S4LD", u16 version, u16 bytes of the leader, u64 block, u64 first plane, u64 device time (ns),
             u32 planes, u16 width, u16 height, u32 pixel format, u32 payload bytes, u32 sync pulses, u32 flags (0),
             u32 CRC32C of the 60 bytes before
    payload  `planes` packed planes, each padded with zero bits to whole bytes
    trailer  magic "S4TR", u32 valid payload bytes, u64 block, u64 planes the device dropped so far, u32 status,
             u32 CRC32C of the payload and the 28 bytes before
"""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass
from typing import NamedTuple

import crc32c
import numpy as np
from numpy.typing import NDArray

from acquisition.errors import DeviceError
from acquisition.spikes.layout import BitOrder, PlaneLayout, RowOrder

PROTOCOL_VERSION = 1
VENDOR_ID = 0x1209  # pid.codes, an identifier open to projects like this one
PRODUCT_ID = 0x0001
STREAM_ENDPOINT = 0x81
IDENTITY_MAGIC = b"S4CM"
LEADER_MAGIC = b"S4LD"
TRAILER_MAGIC = b"S4TR"
LEADER = struct.Struct("<4sHHQQQIHHIIQII")
TRAILER = struct.Struct("<4sIQQII")
MAX_PAYLOAD_BYTES = 1 << 26
_CRC = struct.Struct("<I")
_PIXEL_FORMATS: dict[tuple[BitOrder, RowOrder], int] = {
    ("lsb", "bottom"): 0x10,
    ("msb", "bottom"): 0x11,
    ("lsb", "top"): 0x12,
    ("msb", "top"): 0x13,
}
_LAYOUT_ORDERS = {code: orders for orders, code in _PIXEL_FORMATS.items()}


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
    if code not in _LAYOUT_ORDERS:
        raise DeviceError(f"found the pixel format {code:#x}, expected one of {sorted(map(hex, _LAYOUT_ORDERS))}")
    bit_order, row_order = _LAYOUT_ORDERS[code]
    return PlaneLayout(width, height, bit_order, row_order)


@dataclass(frozen=True, eq=False)
class Block:
    """Planes [first_plane, first_plane + n) of one camera; `packed` is [n, B] bytes.

    `device_time_ns` is the start of the first plane on the device's clock, which the trigger sets to zero;
    `dropped_planes` counts what the device lost so far, `sync_pulses` what it saw of the shared trigger line; bit 0 of
    `status` is an overrun of the device's memory.
    """

    block_id: int
    first_plane: int
    device_time_ns: int
    layout: PlaneLayout
    packed: NDArray[np.uint8]
    sync_pulses: int = 0
    dropped_planes: int = 0
    status: int = 0


@dataclass(frozen=True)
class Damage:
    """Bytes of the stream that were not a block: why, and how many until the next whole one."""

    reason: str
    skipped_bytes: int


def encode_block(block: Block) -> bytes:
    """The block as it travels."""
    payload = np.ascontiguousarray(block.packed).tobytes()
    layout = block.layout
    head = (LEADER_MAGIC, PROTOCOL_VERSION, LEADER.size, block.block_id, block.first_plane, block.device_time_ns)
    shape = (len(block.packed), layout.width, layout.height, pixel_format(layout), len(payload), block.sync_pulses, 0)
    leader = LEADER.pack(*head, *shape, 0)[:-4]
    trailer = TRAILER.pack(TRAILER_MAGIC, len(payload), block.block_id, block.dropped_planes, block.status, 0)[:-4]
    checksum = crc32c.crc32c(trailer, crc32c.crc32c(payload))
    return b"".join((leader, _CRC.pack(crc32c.crc32c(leader)), payload, trailer, _CRC.pack(checksum)))


class BlockParser:
    """Finds whole blocks in a byte stream cut anywhere; after damage it looks for the next leader that checks."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._reason = ""
        self._skipped = 0
        self._ready: Block | None = None
        self.damages = 0  # stretches of damage begun so far

    def feed(self, data: bytes | bytearray | memoryview) -> None:
        """Take the next bytes of the stream."""
        self._buffer += data

    def next(self) -> Block | Damage | None:
        """The next block, the damage before it, or None until more bytes come."""
        block = self._ready or self._find_block()
        if block is None:
            return None
        if self._reason:
            self._ready, damage = block, Damage(self._reason, self._skipped)
            self._reason, self._skipped = "", 0
            return damage
        self._ready = None
        return block

    def _find_block(self) -> Block | None:
        while True:
            at = self._buffer.find(LEADER_MAGIC)
            if at != 0:
                kept = len(LEADER_MAGIC) - 1  # a magic may be cut here
                skip = at if at > 0 else max(0, len(self._buffer) - kept)
                if skip:
                    self._skip(skip, "bytes that are no leader")
                if at < 0:
                    return None
            if len(self._buffer) < LEADER.size:
                return None
            leader = LEADER.unpack_from(self._buffer)
            reason = _leader_fault(self._buffer, leader)
            payload_bytes = leader[10]
            total = LEADER.size + payload_bytes + TRAILER.size
            if not reason:
                if len(self._buffer) < total:
                    return None
                reason = _body_fault(self._buffer, leader)
            if not reason:
                block = _decode(self._buffer, leader)
                del self._buffer[:total]
                return block
            self._skip(len(LEADER_MAGIC), reason)

    def _skip(self, count: int, reason: str) -> None:
        if not self._reason:
            self._reason = reason
            self.damages += 1
        self._skipped += count
        del self._buffer[:count]


def _leader_fault(buffer: bytearray, leader: tuple) -> str:
    if crc32c.crc32c(bytes(buffer[: LEADER.size - 4])) != leader[-1]:
        return "a leader whose CRC does not fit"
    if leader[1] != PROTOCOL_VERSION or leader[2] != LEADER.size or leader[9] not in _LAYOUT_ORDERS:
        return f"a leader of version {leader[1]}, {leader[2]} B, pixel format {leader[9]:#x}"
    planes, width, height, payload_bytes = leader[6], leader[7], leader[8], leader[10]
    if payload_bytes > MAX_PAYLOAD_BYTES or payload_bytes != planes * ((width * height + 7) // 8) or not width * height:
        return f"a leader of {payload_bytes} B for {planes} planes of {width}x{height}"
    return ""


def _body_fault(buffer: bytearray, leader: tuple) -> str:
    payload_bytes = leader[10]
    start = LEADER.size + payload_bytes
    magic, valid_bytes, block_id, _, _, checksum = TRAILER.unpack_from(buffer, start)
    with memoryview(buffer) as view:
        computed = crc32c.crc32c(view[LEADER.size : start + TRAILER.size - 4])
    if computed != checksum:
        return f"block {leader[3]} whose CRC does not fit"
    if magic != TRAILER_MAGIC or block_id != leader[3] or valid_bytes != payload_bytes:
        return f"block {leader[3]} with a trailer for block {block_id}, {valid_bytes} B of {payload_bytes}"
    return ""


def _decode(buffer: bytearray, leader: tuple) -> Block:
    _, _, _, block_id, first_plane, device_time_ns, planes, width, height, code, payload_bytes, pulses, _, _ = leader
    start = LEADER.size + payload_bytes
    _, _, _, dropped, status, _ = TRAILER.unpack_from(buffer, start)
    payload = np.frombuffer(bytes(buffer[LEADER.size : start]), dtype=np.uint8)
    layout = layout_of(width, height, code)
    packed = payload.reshape(planes, layout.plane_bytes)
    return Block(block_id, first_plane, device_time_ns, layout, packed, pulses, dropped, status)


def _unpack(register: struct.Struct, data: bytes, name: str) -> tuple:
    if len(data) != register.size:
        raise DeviceError(f"found {len(data)} B in the {name} register, expected {register.size}")
    return register.unpack(data)
