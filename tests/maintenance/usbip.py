"""A simulated device on a real Linux USB stack: served over USB/IP to the vhci-hcd of this very machine, by root.

Messages are those of the kernel's documentation of USB/IP: 48 B headers, big-endian, then the data.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
import threading
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from acquisition.devices.control_channel import StallError
from acquisition.devices.descriptors import MAX_PACKET_BYTES
from acquisition.errors import DeviceError

HOST_CONTROLLER = Path("/sys/devices/platform/vhci_hcd.0")
HIGH_SPEED, SUPER_SPEED = 3, 5
_SUBMIT, _UNLINK, _SUBMITTED, _UNLINKED = 1, 2, 3, 4
_HEADER = struct.Struct(">IIIIIIiiii8s")
_UNLINK_HEADER = struct.Struct(">IIIIIi24x")
_FREE_PORT = 4
_POLL_S = 0.02


class UsbModel(Protocol):
    """A device below its bus; `maintenance.usb_models` has two."""

    stream_endpoint: int

    def control(self, kind: int, request: int, value: int, index: int, data: bytes = b"") -> bytes:
        """Answer a control request; raises StallError."""
        ...

    def stream(self, size: int, timeout_s: float) -> memoryview:
        """Return bytes of the bulk pipe; raises StallError."""
        ...

    def take(self, endpoint: int, data: bytes) -> None:
        """Take bytes for another bulk pipe; raises StallError."""
        ...

    def give(self, endpoint: int) -> bytes:
        """Return the next message of another bulk pipe, empty where there is none; raises StallError."""
        ...

    def wake(self) -> None:
        """End a waiting `stream`."""
        ...


@dataclass(eq=False)
class _Transfer:
    """A transfer the kernel waits for."""

    number: int
    size: int
    data: bytearray = field(default_factory=bytearray)
    unlinked_by: int | None = None


class UsbIpDevice:
    """Plugs `model` into a free port of the virtual host controller; raises DeviceError where that cannot be."""

    def __init__(self, model: UsbModel, speed: int = SUPER_SPEED):
        self._model = model
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        self._changed = threading.Condition()
        self._waiting: deque[_Transfer] = deque()
        self._asked: deque[tuple[int, _Transfer]] = deque()  # for messages of other endpoints
        self._plugged = True
        try:
            port = _free_port("ss" if speed == SUPER_SPEED else "hs")
            (HOST_CONTROLLER / "attach").write_text(f"{port} {theirs.fileno()} {port + 1} {speed}")
        except OSError as error:
            raise DeviceError(f"{error.strerror}", do="load vhci-hcd and run as root", where=HOST_CONTROLLER) from error
        finally:
            theirs.close()
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._receive, self._send_stream)]
        for thread in self._threads:
            thread.start()

    def unplug(self) -> None:
        """Pull the cable."""
        with self._changed:
            self._plugged = False
            self._changed.notify_all()
        self._socket.shutdown(socket.SHUT_RDWR)
        self._model.wake()
        for thread in self._threads:
            thread.join()
        self._socket.close()

    def _receive(self) -> None:
        while header := self._take(_HEADER.size):
            command, number, _, inward, endpoint, _, size, *_, setup = _HEADER.unpack(header)
            if command == _UNLINK:
                self._unlink(number, struct.unpack_from(">I", header, 20)[0])
            elif endpoint and inward and 0x80 | endpoint == self._model.stream_endpoint:
                with self._changed:
                    self._waiting.append(_Transfer(number, size))
                    self._changed.notify_all()
            elif endpoint:
                self._message(number, endpoint, size, self._take(size) if not inward else None)
            else:
                self._control(number, setup, b"" if inward else self._take(size))

    def _take(self, size: int) -> bytes:
        """Return exactly `size` bytes, or none at the end."""
        data = bytearray()
        while len(data) < size:
            try:
                part = self._socket.recv(size - len(data))
            except OSError:
                part = b""
            if not part:
                return b""
            data += part
        return bytes(data)

    def _control(self, number: int, setup: bytes, data: bytes) -> None:
        kind, request, value, index, size = struct.unpack("<BBHHH", setup)
        try:
            answer = _standard(kind, request)
            if answer is None:
                answer = self._model.control(kind, request, value, index, data)
        except StallError:
            self._submitted(number, -errno.EPIPE, b"", 0)
            return
        answer = answer[:size]
        self._submitted(number, 0, answer, len(answer) if kind & 0x80 else len(data))

    def _message(self, number: int, endpoint: int, size: int, data: bytes | None) -> None:
        """Answer a transfer of another endpoint: `data` is taken at once, without data it waits for a message."""
        try:
            if data is not None:
                self._model.take(endpoint, data)
                self._submitted(number, 0, b"", len(data))
            else:
                self._asked.append((0x80 | endpoint, _Transfer(number, size)))
            while self._asked and (found := self._model.give(self._asked[0][0])):
                _, transfer = self._asked.popleft()
                self._submitted(transfer.number, 0, found[: transfer.size], min(len(found), transfer.size))
        except StallError:
            if data is None:
                self._asked.pop()
            self._submitted(number, -errno.EPIPE, b"", 0)

    def _unlink(self, number: int, unlinked: int) -> None:
        for asked in [each for each in self._asked if each[1].number == unlinked]:
            self._asked.remove(asked)
            self._unlinked(number, -errno.ECONNRESET)
            return
        with self._changed:
            for position, transfer in enumerate(self._waiting):
                if transfer.number == unlinked and position == 0:
                    transfer.unlinked_by = number  # it may have bytes: its thread ends it
                    break
                if transfer.number == unlinked:
                    self._waiting.remove(transfer)
                    self._unlinked(number, -errno.ECONNRESET)
                    break
            else:
                self._unlinked(number, 0)  # it was answered before
        self._model.wake()

    def _send_stream(self) -> None:
        while self._plugged:
            with self._changed:
                if not self._waiting:
                    self._changed.wait(_POLL_S)
                    continue
                transfer = self._waiting[0]
            status = 0
            data: bytes | memoryview = b""
            if transfer.unlinked_by is None:
                try:
                    data = self._model.stream(transfer.size - len(transfer.data), _POLL_S)
                except StallError:
                    status = -errno.EPIPE
            transfer.data += data
            done = status or len(transfer.data) == transfer.size or len(data) % MAX_PACKET_BYTES
            with self._changed:
                if done or transfer.unlinked_by is not None:
                    self._waiting.popleft()
                    self._end(transfer, status)

    def _end(self, transfer: _Transfer, status: int) -> None:
        """Answer a transfer; one that was unlinked keeps the bytes it had got."""
        if transfer.unlinked_by is not None and not transfer.data:
            self._unlinked(transfer.unlinked_by, -errno.ECONNRESET)
            return
        self._submitted(transfer.number, status, transfer.data, len(transfer.data))
        if transfer.unlinked_by is not None:
            self._unlinked(transfer.unlinked_by, 0)

    def _submitted(self, number: int, status: int, data: bytes | bytearray, actual: int) -> None:
        header = _HEADER.pack(_SUBMITTED, number, 0, 0, 0, status & 0xFFFF_FFFF, actual, 0, 0, 0, bytes(8))
        self._write(header, data)

    def _unlinked(self, number: int, status: int) -> None:
        self._write(_UNLINK_HEADER.pack(_UNLINKED, number, 0, 0, 0, status), b"")

    def _write(self, header: bytes, data: bytes | bytearray) -> None:
        with self._changed:
            try:
                self._socket.sendall(header)
                self._socket.sendall(data)
            except OSError:  # the cable was pulled
                self._plugged = False


def is_available() -> bool:
    """Return whether this process may plug devices into a virtual host controller."""
    return os.access(HOST_CONTROLLER / "attach", os.W_OK)


def _free_port(hub: str) -> int:
    for line in (HOST_CONTROLLER / "status").read_text().splitlines()[1:]:
        kind, port, state, *_ = line.split()
        if kind == hub and int(state) == _FREE_PORT:
            return int(port)
    raise DeviceError(f"found no free {hub} port on {HOST_CONTROLLER}", "one", "unplug a device")


def _standard(kind: int, request: int) -> bytes | None:
    """Answer what every device is asked: its status, configuration, interface, power figures."""
    if (kind == 0x80 and request == 0x00) or (kind in (0x81, 0x82) and request == 0x00):
        return bytes(2)
    if (kind, request) in ((0x00, 0x09), (0x01, 0x0B), (0x00, 0x30), (0x00, 0x31), (0x00, 0x03), (0x00, 0x01)):
        return b""
    return None
