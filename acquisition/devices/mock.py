"""A pyusb backend over simulated cameras: everything above it is the code that hardware runs."""

# The base class has no annotations.
# pyright: reportIncompatibleMethodOverride=false
import array
import errno
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import usb.core
import usb.util
from usb.backend import IBackend
from usb.core import USBError

from acquisition.devices import descriptors
from acquisition.devices.control_channel import StallError
from acquisition.devices.device_model import DeviceModel
from acquisition.devices.mock_pipe import MockPipe, Port, UsbfsMemory
from acquisition.devices.stream import pipe_stalled, timed_out

_SUPER_SPEED = 4
_ABSENT = {"bRefresh": 0, "bSynchAddress": 0, "extra_descriptors": []}


@dataclass(eq=False)
class _Handle:
    port: Port


class MockBackend(IBackend):
    """Cameras on one bus. Errors are a kernel's: timeout 110, stall 32 until `clear_halt`, unplugged 19 for ever."""

    def __init__(self, models: Sequence[DeviceModel], usbfs_bytes: int = 1 << 28):
        self._memory = UsbfsMemory(usbfs_bytes)
        self._ports = [Port(model, address) for address, model in enumerate(models, start=1)]

    def unplug(self, serial: str) -> None:
        """Pull the cable of camera `serial`."""
        for port in self._ports:
            if port.model.serial == serial:
                port.plugged = False
                port.model.run.wake()

    def replug(self, serial: str) -> None:
        """Put camera `serial` back; it is a new device, at a new address."""
        for number, port in enumerate(self._ports):
            if port.model.serial == serial:
                port.plugged = False
                port.model.power_up()
                self._ports[number] = Port(port.model, 1 + max(each.address for each in self._ports))

    def open_stream(self, device: usb.core.Device) -> MockPipe:
        """Return the stream of `device`, which must be free."""
        [port] = [port for port in self._ports if port.address == device.address]
        return MockPipe(port, self._memory)

    def enumerate_devices(self) -> list[Port]:
        """Return the cameras that are plugged in."""
        return [port for port in self._ports if port.plugged]

    def get_device_descriptor(self, dev: Port) -> SimpleNamespace:
        """Return the device descriptor and where the device sits."""
        place = {"bus": 1, "address": dev.address, "port_number": dev.address, "port_numbers": (dev.address,)}
        return SimpleNamespace(**descriptors.device(dev.model.profile), **place, speed=_SUPER_SPEED)

    def get_configuration_descriptor(self, dev: Port, config: int) -> SimpleNamespace:
        """Return the only configuration."""
        return _at([descriptors.configuration(dev.model.profile)], config)

    def get_interface_descriptor(self, dev: Port, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Return an interface; each has one setting."""
        return _at([fields for fields, _ in descriptors.interfaces(dev.model.profile)], intf, alt, config)

    def get_endpoint_descriptor(self, dev: Port, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Return an endpoint of an interface."""
        found = descriptors.interfaces(dev.model.profile)
        return _at(found[intf][1] if intf < len(found) else [], ep, alt, config)

    def open_device(self, dev: Port) -> _Handle:
        """Return a handle on a camera that is plugged in."""
        dev.require()
        return _Handle(dev)

    def close_device(self, dev_handle: _Handle) -> None:
        """Give back what the handle claimed."""
        dev_handle.port.release(dev_handle)

    def set_configuration(self, dev_handle: _Handle, config_value: int) -> None:
        """Select configuration 0 (none) or 1."""
        dev_handle.port.require()
        if config_value not in (0, 1):
            raise _no_entity()
        dev_handle.port.configuration = config_value

    def get_configuration(self, dev_handle: _Handle) -> int:
        """Return the active configuration, 0 for none."""
        dev_handle.port.require()
        return dev_handle.port.configuration

    def claim_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Claim the camera for this handle; a second one finds it busy."""
        dev_handle.port.claim(dev_handle)

    def release_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Let another handle claim the camera."""
        if not dev_handle.port.release(dev_handle):
            raise _no_entity()

    def bulk_read(self, dev_handle: _Handle, ep: int, intf: int, buff: array.array, timeout: int) -> int:
        """Put bytes into `buff` and return their number; what is ready at the timeout is a short read."""
        model = dev_handle.port.require()
        if ep != model.profile.stream_endpoint:
            raise _no_entity()
        try:
            data = model.stream.send(len(buff), timeout / 1000)
        except StallError as error:
            raise pipe_stalled() from error
        dev_handle.port.require()
        if not data:
            raise timed_out()
        return _put(data, buff)

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
        """Answer for string descriptors and the vendor's registers; anything else stalls."""
        model = dev_handle.port.require()
        try:
            answer = model.control(bmRequestType, bRequest, wValue, bytes(data))
        except StallError as error:
            raise pipe_stalled() from error
        return _put(answer, data) if bmRequestType & usb.util.CTRL_IN else len(data)

    def clear_halt(self, dev_handle: _Handle, ep: int) -> None:
        """End a stall."""
        dev_handle.port.require().clear_halt()

    def reset_device(self, dev_handle: _Handle) -> None:
        """Have the camera begin anew, without a configuration, at the same address."""
        dev_handle.port.require().power_up()
        dev_handle.port.configuration = 0


def _put(data: bytes | memoryview, buffer: array.array) -> int:
    taken = data[: len(buffer)]
    with memoryview(buffer) as view:
        view[: len(taken)] = taken
    return len(taken)


def _at(found: Sequence[dict], number: int, *others: int) -> SimpleNamespace:
    if number >= len(found) or any(others):
        raise IndexError(f"found no descriptor {(number, *others)}")
    return SimpleNamespace(**{**_ABSENT, **found[number]})


def _no_entity() -> USBError:
    return USBError("Entity not found", -5, errno.ENOENT)
