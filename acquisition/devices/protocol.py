"""Blocks of planes on a camera's bulk pipe: their encoding, and the parser that finds them; see PROTOCOL.md."""

import enum
import struct
from dataclasses import dataclass
from typing import NamedTuple

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
Data = bytes | bytearray | memoryview


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


class _Leader(NamedTuple):
    magic: bytes
    version: int
    leader_bytes: int
    block_id: int
    first_plane: int
    device_time_ns: int
    planes: int
    width: int
    height: int
    pixel_format: int
    payload_bytes: int
    sync_pulses: int
    pulse_age_ns: int
    flags: int
    checksum: int


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
        self._fed_whole: Block | None = None  # comes before the buffer
        self._in_damage = False
        self.damages = self.skipped_bytes = 0  # stretches of damage begun so far, and their bytes

    def feed(self, data: Data) -> None:
        """Take the next bytes of the stream; just one whole block, as most transfers are, is not copied twice."""
        if not self._buffer and self._fed_whole is None:
            block, size = self._decode_first(data)
            if block and size == len(data):
                self._fed_whole = block
                return
        self._buffer += data

    def next(self) -> Block | None:
        """Return the next block, or None until more bytes come."""
        block = self._fed_whole or self._find_block()
        self._fed_whole, self._in_damage = None, self._in_damage and block is None
        return block

    def _find_block(self) -> Block | None:
        while self._at_a_magic():
            block, size = self._decode_first(self._buffer)
            if block:
                del self._buffer[:size]
            if block or size:
                return block
            self._skip(len(LEADER_MAGIC))
        return None

    def _decode_first(self, data: Data) -> tuple[Block | None, int]:
        """Return the block `data` begins with and its length; None and 0 where it begins with none.

        Returns None and the length needed where more bytes must come.
        """
        if len(data) < LEADER.size:
            return None, LEADER.size
        leader = _Leader._make(LEADER.unpack_from(data))
        if not _is_sound(leader, data) or leader.payload_bytes > self._max_payload_bytes:
            return None, 0
        total = LEADER.size + leader.payload_bytes + TRAILER.size
        if len(data) < total:
            return None, total
        block = _decode(leader, data)
        return block, total if block else 0

    def _at_a_magic(self) -> bool:
        """Skip to the next magic, and return whether there is one; the last bytes may begin one that was cut."""
        at = self._buffer.find(LEADER_MAGIC)
        self._skip(at if at >= 0 else max(0, len(self._buffer) - len(LEADER_MAGIC) + 1))
        return at >= 0

    def _skip(self, count: int) -> None:
        self.damages += not self._in_damage and count > 0
        self._in_damage |= count > 0
        self.skipped_bytes += count
        del self._buffer[:count]


def _is_sound(leader: _Leader, data: Data) -> bool:
    if leader.magic != LEADER_MAGIC or crc32c.crc32c(bytes(data[: LEADER.size - 4])) != leader.checksum:
        return False
    known = leader.version == PROTOCOL_VERSION and leader.leader_bytes == LEADER.size
    pixels = leader.width * leader.height
    whole = pixels > 0 and leader.payload_bytes == leader.planes * ((pixels + 7) // 8)
    return known and leader.pixel_format in LAYOUT_ORDERS and whole


def _decode(leader: _Leader, data: Data) -> Block | None:
    """Return the block behind a sound leader; None where its trailer or its checksum does not fit."""
    end = LEADER.size + leader.payload_bytes
    magic, valid_bytes, block_id, dropped, status, checksum = TRAILER.unpack_from(data, end)
    with memoryview(data) as view, view[LEADER.size : end + TRAILER.size - 4] as checked:
        computed = crc32c.crc32c(checked)
    if (computed, magic, block_id, valid_bytes) != (checksum, TRAILER_MAGIC, leader.block_id, leader.payload_bytes):
        return None
    payload = np.frombuffer(data, dtype=np.uint8, count=leader.payload_bytes, offset=LEADER.size).copy()
    layout = layout_of(leader.width, leader.height, leader.pixel_format)
    packed = payload.reshape(leader.planes, layout.plane_bytes)
    began = leader.block_id, leader.first_plane, leader.device_time_ns
    return Block(*began, layout, packed, leader.sync_pulses, dropped, status, leader.pulse_age_ns)
