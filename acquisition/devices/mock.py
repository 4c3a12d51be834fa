"""A pyusb backend over simulated cameras: everything above it is the code that hardware runs."""

# The base class has no annotations.
# pyright: reportIncompatibleMethodOverride=false
from __future__ import annotations

import array
import errno
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import usb.core
import usb.util
from usb.backend import IBackend
from usb.core import USBError

from acquisition.devices import descriptors
from acquisition.devices.control_channel import StallError
from acquisition.devices.descriptors import MAX_PACKET_BYTES
from acquisition.devices.device_model import DeviceModel
from acquisition.devices.stream import Completion, Outcome, device_gone, pipe_stalled, timed_out

_SUPER_SPEED = 4


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


class MockPipe:
    """The stream of the camera at `port`, which it holds until `close`."""

    def __init__(self, port: Port, bus: MockBackend):
        model = port.require()
        if port.claimed:
            raise USBError("Resource busy", -6, errno.EBUSY)
        port.claimed = True
        self._port, self._bus = port, bus
        self._transfer_bytes = model.profile.transfer_bytes
        self._flying: deque[bytearray] = deque()
        self._cancelled = 0

    def submit(self) -> None:
        """Queue one more transfer."""
        self._port.require()
        if self._bus.free_bytes < self._transfer_bytes:
            raise USBError("Insufficient memory", -11, errno.ENOMEM)
        self._bus.free_bytes -= self._transfer_bytes
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
        self._bus.free_bytes += self._transfer_bytes
        return Completion(outcome, memoryview(self._flying.popleft()))


class MockBackend(IBackend):
    """Cameras on one bus. Errors are a kernel's: timeout 110, stall 32 until `clear_halt`, unplugged 19 for ever."""

    def __init__(self, models: Sequence[DeviceModel], usbfs_bytes: int = 1 << 28):
        self.free_bytes = usbfs_bytes  # of the memory that the kernel lets all transfers take together
        self._ports = [Port(model, address) for address, model in enumerate(models, start=1)]

    def unplug(self, serial: str) -> None:
        """Pull the cable of camera `serial`."""
        for port in self._ports:
            if port.model.serial == serial:
                port.plugged = False
                port.model.run.wake()

    def open_stream(self, device: usb.core.Device) -> MockPipe:
        """Return the stream of `device`, which must be free."""
        [port] = [port for port in self._ports if port.address == device.address]
        return MockPipe(port, self)

    def enumerate_devices(self) -> list[Port]:
        """Return the cameras that are plugged in."""
        return [port for port in self._ports if port.plugged]

    def get_device_descriptor(self, dev: Port) -> SimpleNamespace:
        """Return the device descriptor and where the device sits."""
        place = {"bus": 1, "address": dev.address, "port_number": dev.address, "port_numbers": (dev.address,)}
        return SimpleNamespace(**descriptors.device(dev.model.profile), **place, speed=_SUPER_SPEED)

    def get_configuration_descriptor(self, dev: Port, config: int) -> SimpleNamespace:
        """Return the only configuration."""
        if config:
            raise IndexError(f"found no configuration {config}")
        return SimpleNamespace(**descriptors.CONFIGURATION_FIELDS, extra_descriptors=[])

    def open_device(self, dev: Port) -> Port:
        """Return a handle on a camera that is plugged in."""
        dev.require()
        return dev

    def close_device(self, dev_handle: Port) -> None:
        """Do nothing: a pipe holds the camera, not a handle."""

    def set_configuration(self, dev_handle: Port, config_value: int) -> None:
        """Select the only configuration, which a camera is always in."""
        dev_handle.require()

    def ctrl_transfer(
        self,
        dev_handle: Port,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: array.array,
        timeout: int,
    ) -> int:
        """Answer for string descriptors and the vendor's registers; anything else stalls."""
        model = dev_handle.require()
        try:
            answer = model.control(bmRequestType, bRequest, wValue, bytes(data))
        except StallError as error:
            raise pipe_stalled() from error
        taken = array.array("B", answer[: len(data)])
        data[: len(taken)] = taken
        return len(taken) if bmRequestType & usb.util.CTRL_IN else len(data)

    def reset_device(self, dev_handle: Port) -> None:
        """Have the camera begin anew, at the same address."""
        dev_handle.require().power_up()
