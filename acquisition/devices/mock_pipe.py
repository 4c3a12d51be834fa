"""The stream pipe of a simulated camera, whose transfers are filled as a kernel fills them."""

import errno
import time
from collections import deque
from dataclasses import dataclass

from usb.core import USBError

from acquisition.devices.control_channel import StallError
from acquisition.devices.descriptors import MAX_PACKET_BYTES
from acquisition.devices.device_model import DeviceModel
from acquisition.devices.stream import Completion, Outcome, device_gone, pipe_stalled, timed_out


@dataclass(eq=False)
class Port:
    """A port of the mock bus, and the camera that is plugged into it."""

    model: DeviceModel
    address: int
    plugged: bool = True
    configuration: int = 0
    claimed: bool = False

    def require(self) -> DeviceModel:
        """Return the camera; raises USBError ENODEV for one that was unplugged."""
        if not self.plugged:
            raise device_gone()
        return self.model


@dataclass(eq=False)
class UsbfsMemory:
    """The memory that the kernel lets all transfers take together."""

    free_bytes: int


class MockPipe:
    """The stream of the camera at `port`, which it holds until `close`."""

    def __init__(self, port: Port, memory: UsbfsMemory):
        model = port.require()
        if port.claimed:
            raise USBError("Resource busy", -6, errno.EBUSY)
        port.claimed = True
        self._port, self._memory = port, memory
        self._transfer_bytes = model.profile.transfer_bytes
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
        """Return the oldest transfer, or None when it does not end within `timeout_s`."""
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
                data = self._port.model.stream.send(self._transfer_bytes - len(buffer), max(0.0, left_s))
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
        self._port.require().stream.halted = False

    def write(self, endpoint: int, data: bytes, timeout_s: float) -> None:
        """Send all of `data` to another endpoint."""
        model = self._port.require()
        try:
            model.messages.take(endpoint, data)
        except StallError as error:
            raise pipe_stalled() from error

    def read(self, endpoint: int, size: int, timeout_s: float) -> bytes:
        """Return what another endpoint has; there is nothing to wait for."""
        model = self._port.require()
        try:
            data = model.messages.give(endpoint)
        except StallError as error:
            raise pipe_stalled() from error
        if not data:
            raise timed_out()
        return data[:size]

    def close(self) -> None:
        """Give the camera back."""
        while self._flying:
            self._ended(Outcome.CANCELLED)
        self._port.claimed = False

    def _ended(self, outcome: Outcome) -> Completion:
        self._memory.free_bytes += self._transfer_bytes
        return Completion(outcome, memoryview(self._flying.popleft()))
