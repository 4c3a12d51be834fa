"""Two ways to a camera's registers: vendor requests, and messages through a pair of bulk pipes; see PROTOCOL.md.

Either raises USBError, EPIPE for what the camera refuses.
"""

from __future__ import annotations

import contextlib
import errno
import struct
import threading
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import crc32c
import usb.core
import usb.util
from usb.core import USBError

from acquisition.devices.profile import Profile
from acquisition.devices.registers import REGISTER_BYTES, Request
from acquisition.devices.stream import StreamPipe, pipe_stalled

CONTROL_TIMEOUT_S = 1.0
COMMAND_MAGIC, REPLY_MAGIC = b"S4RQ", b"S4RP"
MOST_DATA_BYTES = 64
DONE, REFUSED = 0, 1
_READ = usb.util.CTRL_IN | usb.util.CTRL_TYPE_VENDOR | usb.util.CTRL_RECIPIENT_DEVICE
_WRITE = usb.util.CTRL_OUT | usb.util.CTRL_TYPE_VENDOR | usb.util.CTRL_RECIPIENT_DEVICE
_HEADER = struct.Struct("<4sBBHI")
_CRC = struct.Struct("<I")
_MOST_BYTES = 1024  # bytes asked of the reply pipe: one packet, which holds any message
_STALE_REPLIES = 64  # replies to other commands that are passed over before the own one is given up


class StallError(Exception):
    """The device refuses a request, or its pipe is halted."""


class Message(NamedTuple):
    """A command or its reply, with the same `number`.

    A command with `note` 0 reads the register `request`, with 1 it does what that asks; a reply has 0 for done, 1 for
    refused.
    """

    magic: bytes
    request: int
    note: int
    number: int
    data: bytes = b""

    def encode(self) -> bytes:
        """Return the message's bytes."""
        head = _HEADER.pack(self.magic, self.request, self.note, self.number, len(self.data)) + self.data
        return head + _CRC.pack(crc32c.crc32c(head))

    @classmethod
    def decode(cls, data: bytes) -> Message | None:
        """Return the message with these bytes; None for bytes that are no message."""
        if not _HEADER.size + _CRC.size <= len(data) <= _HEADER.size + MOST_DATA_BYTES + _CRC.size:
            return None
        magic, request, note, number, size = _HEADER.unpack_from(data)
        whole = size == len(data) - _HEADER.size - _CRC.size
        if not whole or _CRC.unpack_from(data, len(data) - _CRC.size)[0] != crc32c.crc32c(data[: -_CRC.size]):
            return None
        return cls(magic, request, note, number, data[_HEADER.size : -_CRC.size])


class RequestChannel:
    """Vendor control requests to the device."""

    def __init__(self, device: usb.core.Device):
        self._device = device

    def read(self, request: Request) -> bytes:
        """Return the register's bytes."""
        size, timeout_ms = REGISTER_BYTES[request], round(CONTROL_TIMEOUT_S * 1e3)
        return bytes(self._device.ctrl_transfer(_READ, request, 0, 0, size, timeout_ms))

    def write(self, request: Request, data: bytes = b"") -> None:
        """Have the camera do `request`."""
        self._device.ctrl_transfer(_WRITE, request, 0, 0, data or None, round(CONTROL_TIMEOUT_S * 1e3))


class MessageChannel:
    """Commands to one bulk pipe, numbered, and their replies from another; one at a time."""

    def __init__(self, pipes: StreamPipe, profile: Profile):
        self._pipes = pipes
        self._command, self._reply = profile.command_endpoint, profile.reply_endpoint
        self._number = 0
        self._one_at_a_time = threading.Lock()

    def read(self, request: Request) -> bytes:
        """Return the register's bytes."""
        return self._exchange(request, 0, b"")

    def write(self, request: Request, data: bytes = b"") -> None:
        """Have the camera do `request`."""
        self._exchange(request, 1, data)

    def _exchange(self, request: int, note: int, data: bytes) -> bytes:
        with self._one_at_a_time:
            self._number = (self._number + 1) & 0xFFFF
            command = Message(COMMAND_MAGIC, request, note, self._number, data)
            self._pipes.write(self._command, command.encode(), CONTROL_TIMEOUT_S)
            for _ in range(_STALE_REPLIES):  # replies to commands that timed out, or to another program
                reply = Message.decode(self._pipes.read(self._reply, _MOST_BYTES, CONTROL_TIMEOUT_S))
                if reply and reply[:2] == (REPLY_MAGIC, request) and reply.number == self._number:
                    break
            else:
                raise USBError("Input/Output Error", -1, errno.EIO)
        if reply.note != DONE:
            raise pipe_stalled()
        return reply.data


class MessageEnd:
    """The device's end: answers commands by `read` and `write`, which raise StallError for what they do not do.

    Both pipes raise StallError where `profile` has none at that endpoint.
    """

    def __init__(self, profile: Profile, read: Callable[[int], bytes], write: Callable[[int, bytes], None]):
        self._profile, self._read, self._write = profile, read, write
        self._replies: deque[bytes] = deque()

    def take(self, endpoint: int, data: bytes) -> None:
        """Obey a command; bytes that are none are forgotten."""
        if not endpoint or endpoint != self._profile.command_endpoint:
            raise StallError
        command = Message.decode(data)
        if command is None or command.magic != COMMAND_MAGIC:
            return
        answer, note = b"", REFUSED
        with contextlib.suppress(StallError):
            if command.note == 0:
                answer = self._read(command.request)
            else:
                self._write(command.request, command.data)
            note = DONE
        self._replies.append(Message(REPLY_MAGIC, command.request, note, command.number, answer).encode())

    def give(self, endpoint: int) -> bytes:
        """Return the next reply; empty where there is none."""
        if not endpoint or endpoint != self._profile.reply_endpoint:
            raise StallError
        return self._replies.popleft() if self._replies else b""
