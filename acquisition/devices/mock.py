"""A pyusb backend over simulated cameras: everything above it is the code that hardware runs."""

# The base class has no annotations.
# pyright: reportIncompatibleMethodOverride=false
from __future__ import annotations

import array
import errno
from collections.abc import Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace

import usb.util
from usb.backend import IBackend
from usb.core import USBError, USBTimeoutError

from acquisition.devices.device_model import (
    CONFIGURATION_DESCRIPTOR,
    DEVICE_DESCRIPTOR,
    ENDPOINT_DESCRIPTOR,
    INTERFACE_DESCRIPTOR,
    DeviceModel,
    StallError,
)
from acquisition.devices.protocol import STREAM_ENDPOINT
from acquisition.recording.manifest import Trigger

_SUPER_SPEED = 4
_GET_DESCRIPTOR = 0x06
_STRING = 3


@dataclass(eq=False)
class _Port:
    """Where one camera is plugged in."""

    model: DeviceModel
    address: int
    plugged: bool = True
    halted: bool = False
    configuration: int = 0
    claimed_by: _Handle | None = None


@dataclass(eq=False)
class _Handle:
    port: _Port
    claimed: set[int] = field(default_factory=set)


def _timed_out() -> USBTimeoutError:
    return USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)


def _stalled() -> USBError:
    return USBError("Pipe error", -9, errno.EPIPE)


class MockBackend(IBackend):
    """Cameras on one bus. Errors are a kernel's: timeout 110, stall 32 until `clear_halt`, unplugged 19 for ever."""

    def __init__(self, models: Sequence[DeviceModel]):
        self._ports = [_Port(model, address) for address, model in enumerate(models, start=1)]

    def unplug(self, serial: str) -> None:
        """Pull the cable of camera `serial`."""
        for port in self._ports:
            if port.model.serial == serial:
                port.plugged = False
                port.model.wake()

    def halt(self, serial: str) -> None:
        """Stall the stream of camera `serial` until the host clears it."""
        for port in self._ports:
            port.halted |= port.model.serial == serial

    def enumerate_devices(self) -> list[_Port]:
        """The cameras that are plugged in."""
        return [port for port in self._ports if port.plugged]

    def get_parent(self, dev: _Port) -> None:
        """No hub: every camera has a root port."""

    def get_device_descriptor(self, dev: _Port) -> SimpleNamespace:
        """The device descriptor and where the device sits."""
        place = {"bus": 1, "address": dev.address, "port_number": dev.address, "port_numbers": (dev.address,)}
        return SimpleNamespace(**DEVICE_DESCRIPTOR, **place, speed=_SUPER_SPEED)

    def get_configuration_descriptor(self, dev: _Port, config: int) -> SimpleNamespace:
        """The only configuration."""
        return _only(CONFIGURATION_DESCRIPTOR, config)

    def get_interface_descriptor(self, dev: _Port, intf: int, alt: int, config: int) -> SimpleNamespace:
        """The only interface."""
        return _only(INTERFACE_DESCRIPTOR, intf, alt, config)

    def get_endpoint_descriptor(self, dev: _Port, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        """The only endpoint."""
        return _only(ENDPOINT_DESCRIPTOR, ep, intf, alt, config)

    def open_device(self, dev: _Port) -> _Handle:
        """A handle on a camera that is plugged in."""
        return _Handle(_plugged(dev))

    def close_device(self, dev_handle: _Handle) -> None:
        """Give back what the handle claimed."""
        if dev_handle.port.claimed_by is dev_handle:
            dev_handle.port.claimed_by = None

    def set_configuration(self, dev_handle: _Handle, config_value: int) -> None:
        """Select configuration 0 (none) or 1."""
        if config_value not in (0, 1):
            raise USBError("Entity not found", -5, errno.ENOENT)
        _plugged(dev_handle.port).configuration = config_value

    def get_configuration(self, dev_handle: _Handle) -> int:
        """The active configuration, 0 for none."""
        return _plugged(dev_handle.port).configuration

    def set_interface_altsetting(self, dev_handle: _Handle, intf: int, altsetting: int) -> None:
        """There is only setting 0."""
        _plugged(dev_handle.port)
        if (intf, altsetting) != (0, 0):
            raise USBError("Entity not found", -5, errno.ENOENT)

    def claim_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Exclusive: a second handle finds it busy."""
        port = _plugged(dev_handle.port)
        if port.claimed_by not in (None, dev_handle):
            raise USBError("Resource busy", -6, errno.EBUSY)
        port.claimed_by = dev_handle

    def release_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Let another handle claim it."""
        port = _plugged(dev_handle.port)
        if port.claimed_by is not dev_handle:
            raise USBError("Entity not found", -5, errno.ENOENT)
        port.claimed_by = None

    def bulk_read(self, dev_handle: _Handle, ep: int, intf: int, buff: array.array, timeout: int) -> int:
        """Bytes put into `buff`; what is ready after a timeout is a short read, nothing is error 110."""
        port = _plugged(dev_handle.port)
        if ep != STREAM_ENDPOINT:
            raise USBError("Entity not found", -5, errno.ENOENT)
        if port.halted:
            raise _stalled()
        data = port.model.stream(len(buff), timeout / 1000)
        _plugged(port)
        if not data:
            raise _timed_out()
        with memoryview(buff) as view:
            view[: len(data)] = data
        return len(data)

    def bulk_write(self, dev_handle: _Handle, ep: int, intf: int, data: array.array, timeout: int) -> int:
        """The cameras have no pipe to write to."""
        _plugged(dev_handle.port)
        raise USBError("Entity not found", -5, errno.ENOENT)

    def ctrl_transfer(
        self,
        dev_handle: _Handle,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: array.array,
        timeout: int,
    ) -> int:
        """String descriptors and the vendor's registers; anything else stalls."""
        model = _plugged(dev_handle.port).model
        kind, inward = bmRequestType & 0x60, bool(bmRequestType & usb.util.CTRL_IN)
        try:
            if kind == usb.util.CTRL_TYPE_VENDOR and not inward:
                model.command(bRequest)
                return 0
            if kind == usb.util.CTRL_TYPE_VENDOR:
                answer = model.read_register(bRequest)
            elif inward and bRequest == _GET_DESCRIPTOR and wValue >> 8 == _STRING:
                answer = model.string_descriptor(wValue & 0xFF)
            else:
                raise StallError
        except StallError as error:
            raise _stalled() from error
        taken = answer[: len(data)]
        with memoryview(data) as view:
            view[: len(taken)] = taken
        return len(taken)

    def clear_halt(self, dev_handle: _Handle, ep: int) -> None:
        """End a stall."""
        _plugged(dev_handle.port).halted = False

    def reset_device(self, dev_handle: _Handle) -> None:
        """End a stall and forget the configuration."""
        port = _plugged(dev_handle.port)
        port.halted, port.configuration = False, 0

    def is_kernel_driver_active(self, dev_handle: _Handle, intf: int) -> bool:
        """No kernel driver takes a vendor-class device."""
        _plugged(dev_handle.port)
        return False


class MockTriggerLine:
    """One wire to every camera: a pulse starts all armed ones on the same tick."""

    kind: Trigger = "line"

    def __init__(self, models: Sequence[DeviceModel]):
        self._models = tuple(models)

    def fire(self) -> None:
        """Send one pulse."""
        for model in self._models:
            model.trigger()


def _plugged(port: _Port) -> _Port:
    if not port.plugged:
        raise USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)
    return port


def _only(fields: dict, *numbers: int) -> SimpleNamespace:
    if any(numbers):
        raise IndexError(f"found no descriptor {numbers}")
    return SimpleNamespace(**fields)
