"""The stream pipe of a simulated camera: transfers as a kernel fills them, without a kernel."""

from __future__ import annotations

import errno
import time
from collections import deque
from dataclasses import dataclass

from usb.core import USBError, USBTimeoutError

from acquisition.devices.control_channel import StallError
from acquisition.devices.descriptors import MAX_PACKET_BYTES
from acquisition.devices.device_model import DeviceModel
from acquisition.devices.stream import Completion, Outcome


@dataclass(eq=False)
class Port:
    """Where one camera is plugged in."""

    model: DeviceModel
    address: int
    plugged: bool = True
    configuration: int = 0
    claimed_by: object | None = None

    def require(self) -> DeviceModel:
        """The camera; raises USBError ENODEV for one that was unplugged."""
        if not self.plugged:
            raise USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)
        return self.model

    def claim(self, holder: object) -> None:
        """Hold the camera; raises USBError EBUSY where another does."""
        self.require()
        if self.claimed_by not in (None, holder):
            raise USBError("Resource busy", -6, errno.EBUSY)
        self.claimed_by = holder


@dataclass(eq=False)
class UsbfsMemory:
    """What the kernel lets all transfers take together."""

    free_bytes: int


class MockPipe:
    """The stream of the camera at `port`, which it holds until `close`."""

    def __init__(self, port: Port, memory: UsbfsMemory):
        port.claim(self)
        self._port, self._memory = port, memory
        self._transfer_bytes = port.model.profile.transfer_bytes
        self._flying: deque[bytearray] = deque()
        self._cancelled = 0

    def submit(self) -> None:
        """Queue one more transfer."""
        self._port.require()
        if self._memory.free_bytes < self._transfer_bytes:
            raise USBError("Insufficient memory", -11, errno.ENOMEM)
        self._memory.free_bytes -= self._transfer_bytes
        self._flying.append(bytearray())

    def reap(self, timeout_s: float) -> Completion | None:
        """The oldest transfer, or None when it does not end within `timeout_s`."""
        if not self._flying:
            return None
        if self._cancelled:
            self._cancelled -= 1
            return self._ended(Outcome.CANCELLED)
        buffer = self._flying[0]
        deadline_s = time.monotonic() + timeout_s
        while True:
            if not self._port.plugged:
                return self._ended(Outcome.GONE)
            left_s = deadline_s - time.monotonic()
            try:
                data = self._port.model.stream(self._transfer_bytes - len(buffer), max(0.0, left_s))
            except StallError:
                return self._ended(Outcome.STALLED)
            buffer += data
            if len(buffer) == self._transfer_bytes or len(data) % MAX_PACKET_BYTES:
                return self._ended(Outcome.DONE)
            if left_s <= 0:
                return None

    def cancel(self) -> None:
        """Ask for all transfers to end now."""
        self._cancelled = len(self._flying)

    def clear_halt(self) -> None:
        """End a stall."""
        self._port.require().clear_halt()

    def write(self, endpoint: int, data: bytes, timeout_s: float) -> None:
        """Send all of `data` to another endpoint."""
        model = self._port.require()
        try:
            model.take(endpoint, data)
        except StallError as error:
            raise USBError("Pipe error", -9, errno.EPIPE) from error

    def read(self, endpoint: int, size: int, timeout_s: float) -> bytes:
        """What another endpoint has; there is nothing to wait for."""
        model = self._port.require()
        try:
            data = model.give(endpoint)
        except StallError as error:
            raise USBError("Pipe error", -9, errno.EPIPE) from error
        if not data:
            raise USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        return data[:size]

    def close(self) -> None:
        """Give the camera back."""
        while self._flying:
            self._ended(Outcome.CANCELLED)
        if self._port.claimed_by is self:
            self._port.claimed_by = None

    def _ended(self, outcome: Outcome) -> Completion:
        self._memory.free_bytes += self._transfer_bytes
        return Completion(outcome, memoryview(self._flying.popleft()))
