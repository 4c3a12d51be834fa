"""Blocks of planes on a camera's bulk pipe: their encoding, and the parser that finds them; see PROTOCOL.md."""

from __future__ import annotations

import enum
import struct
from collections import deque
from dataclasses import dataclass

import crc32c
import numpy as np
from numpy.typing import NDArray

from acquisition.devices.registers import LAYOUT_ORDERS, PROTOCOL_VERSION, layout_of, pixel_format
from acquisition.spikes.layout import PlaneLayout

LEADER_MAGIC = b"S4LD"
TRAILER_MAGIC = b"S4TR"
LEADER = struct.Struct("<4sHHQQQIHHIIIIII")
TRAILER = struct.Struct("<4sIQQII")
MAX_PAYLOAD_BYTES = 1 << 26
NO_PULSE = 0xFFFF_FFFF  # the age of a sync pulse that never came, or is older than 4.29 s
_CRC = struct.Struct("<I")
_REMEMBERED_BLOCKS = 16


class BlockStatus(enum.IntFlag):
    """Bits of a block's `status`."""

    OVERRUN = 1  # the device's memory was full since the block before
    DISCARDED = 2  # it threw planes away since the block before
    TRIGGER_MISSED = 4  # it runs, but has seen no pulse of the line in this run


@dataclass(frozen=True, eq=False)
class Block:
    """Planes [first_plane, first_plane + n) of one camera; `packed` is [n, B] bytes.

    `device_time_ns` is the start of the first plane on the device's clock, which the trigger sets to zero.
    `dropped_planes` counts the planes that the device lost so far, `sync_pulses` the pulses of the shared line that it
    saw; the last of these came `pulse_age_ns` before `device_time_ns`. `status` holds BlockStatus bits.
    """

    block_id: int
    first_plane: int
    device_time_ns: int
    layout: PlaneLayout
    packed: NDArray[np.uint8]
    sync_pulses: int = 0
    dropped_planes: int = 0
    status: int = 0
    pulse_age_ns: int = NO_PULSE

    @property
    def pulse_time_s(self) -> float | None:
        """Return when pulse `sync_pulses` came, in seconds on the device's clock; None where none is known."""
        return None if self.pulse_age_ns == NO_PULSE else (self.device_time_ns - self.pulse_age_ns) * 1e-9


@dataclass(frozen=True)
class Damage:
    """Bytes of the stream that were no block: the reason, and their number up to the next whole block."""

    reason: str
    skipped_bytes: int


def encode_block(block: Block) -> bytes:
    """Return the block as it travels."""
    payload = np.ascontiguousarray(block.packed).tobytes()
    layout = block.layout
    head = (LEADER_MAGIC, PROTOCOL_VERSION, LEADER.size, block.block_id, block.first_plane, block.device_time_ns)
    shape = (len(block.packed), layout.width, layout.height, pixel_format(layout), len(payload))
    leader = LEADER.pack(*head, *shape, block.sync_pulses, block.pulse_age_ns, 0, 0)[:-4]
    trailer = TRAILER.pack(TRAILER_MAGIC, len(payload), block.block_id, block.dropped_planes, block.status, 0)[:-4]
    checksum = crc32c.crc32c(trailer, crc32c.crc32c(payload))
    return b"".join((leader, _CRC.pack(crc32c.crc32c(leader)), payload, trailer, _CRC.pack(checksum)))


class BlockParser:
    """Finds whole blocks in a byte stream cut anywhere; behind damage it looks for the next leader that checks.

    No leader may promise more than `max_payload_bytes`, so that damage to a length is seen at once.
    """

    def __init__(self, max_payload_bytes: int = MAX_PAYLOAD_BYTES) -> None:
        self._max_payload_bytes = max_payload_bytes
        self._buffer = bytearray()
        self._reason = ""
        self._skipped = 0
        self._ready: Block | None = None
        self._fed_whole: Block | None = None  # comes before the buffer
        self.damages = 0  # stretches of damage begun so far

    def feed(self, data: bytes | bytearray | memoryview) -> None:
        """Take the next bytes of the stream; just one whole block, as most transfers are, is not copied twice."""
        if not self._buffer and self._fed_whole is None:
            block, size = self._decode_first(data)
            if isinstance(block, Block) and size == len(data):
                self._fed_whole = block
                return
        self._buffer += data

    def next(self) -> Block | Damage | None:
        """Return the next block, the damage before it, or None until more bytes come."""
        block = self._ready or self._fed_whole or self._find_block()
        if block is None:
            return None
        self._fed_whole = None
        if self._reason:
            self._ready, damage = block, Damage(self._reason, self._skipped)
            self._reason, self._skipped = "", 0
            return damage
        self._ready = None
        return block

    def _find_block(self) -> Block | None:
        while self._at_a_magic():
            block, size = self._decode_first(self._buffer)
            if isinstance(block, str):
                self._skip(len(LEADER_MAGIC), block)
                continue
            del self._buffer[:size]
            return block
        return None

    def _decode_first(self, data: bytes | bytearray | memoryview) -> tuple[Block | str | None, int]:
        """Return the block `data` begins with and its length.

        Where it begins with none, return the reason and 0; where more bytes are needed, None and 0.
        """
        if len(data) < LEADER.size:
            return None, 0
        leader = LEADER.unpack_from(data)
        reason = _leader_fault(data, leader, self._max_payload_bytes)
        total = LEADER.size + leader[10] + TRAILER.size
        if not reason and len(data) < total:
            return None, 0
        reason = reason or _body_fault(data, leader)
        return (reason, 0) if reason else (_decode(data, leader), total)

    def _at_a_magic(self) -> bool:
        """Skip to the next magic, and return whether there is one; the last bytes may begin one that was cut."""
        at = self._buffer.find(LEADER_MAGIC)
        skip = at if at >= 0 else max(0, len(self._buffer) - len(LEADER_MAGIC) + 1)
        if skip:
            self._skip(skip, "bytes that are no leader")
        return at >= 0

    def _skip(self, count: int, reason: str) -> None:
        if not self._reason:
            self._reason = reason
            self.damages += 1
        self._skipped += count
        del self._buffer[:count]


class RepeatFilter:
    """Tells a block that came twice from the next one; a camera that begins again at plane 0 is no repeat."""

    def __init__(self) -> None:
        self.repeats = 0
        self._seen: deque[tuple[int, int, int]] = deque(maxlen=_REMEMBERED_BLOCKS)

    def is_repeat(self, block: Block) -> bool:
        """Return whether this very block was among the last 16."""
        key = block.block_id, block.first_plane, block.device_time_ns
        if key in self._seen:
            self.repeats += 1
            return True
        self._seen.append(key)
        return False


def _leader_fault(buffer: bytes | bytearray | memoryview, leader: tuple, max_payload_bytes: int) -> str:
    if leader[0] != LEADER_MAGIC or crc32c.crc32c(bytes(buffer[: LEADER.size - 4])) != leader[-1]:
        return "a leader whose CRC does not fit"
    if leader[1] != PROTOCOL_VERSION or leader[2] != LEADER.size or leader[9] not in LAYOUT_ORDERS:
        return f"a leader of version {leader[1]}, {leader[2]} B, pixel format {leader[9]:#x}"
    planes, width, height, payload_bytes = leader[6], leader[7], leader[8], leader[10]
    if payload_bytes > max_payload_bytes or payload_bytes != planes * ((width * height + 7) // 8) or not width * height:
        return f"a leader of {payload_bytes} B for {planes} planes of {width}x{height}"
    return ""


def _body_fault(buffer: bytes | bytearray | memoryview, leader: tuple) -> str:
    payload_bytes = leader[10]
    start = LEADER.size + payload_bytes
    magic, valid_bytes, block_id, _, _, checksum = TRAILER.unpack_from(buffer, start)
    with memoryview(buffer) as view, view[LEADER.size : start + TRAILER.size - 4] as checked:
        computed = crc32c.crc32c(checked)
    if computed != checksum:
        return f"block {leader[3]} whose CRC does not fit"
    if magic != TRAILER_MAGIC or block_id != leader[3] or valid_bytes != payload_bytes:
        return f"block {leader[3]} with a trailer for block {block_id}, {valid_bytes} B of {payload_bytes}"
    return ""


def _decode(buffer: bytes | bytearray | memoryview, leader: tuple) -> Block:
    _, _, _, block_id, first_plane, device_time_ns, planes, width, height, code, payload_bytes, pulses, age, _, _ = (
        leader
    )
    start = LEADER.size + payload_bytes
    _, _, _, dropped, status, _ = TRAILER.unpack_from(buffer, start)
    payload = np.frombuffer(buffer, dtype=np.uint8, count=payload_bytes, offset=LEADER.size).copy()
    layout = layout_of(width, height, code)
    packed = payload.reshape(planes, layout.plane_bytes)
    return Block(block_id, first_plane, device_time_ns, layout, packed, pulses, dropped, status, age)
