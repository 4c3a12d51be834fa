"""A pyusb backend over simulated cameras: everything above it is the code that hardware runs."""

# The base class has no annotations.
# pyright: reportIncompatibleMethodOverride=false
import array
from collections.abc import Sequence
from types import SimpleNamespace

import usb.core
import usb.util
from usb.backend import IBackend

from acquisition.devices import descriptors
from acquisition.devices.control_channel import StallError
from acquisition.devices.device_model import DeviceModel
from acquisition.devices.mock_pipe import MockPipe, Port, UsbfsMemory
from acquisition.devices.stream import pipe_stalled

_SUPER_SPEED = 4


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
        return _put(answer, data) if bmRequestType & usb.util.CTRL_IN else len(data)

    def reset_device(self, dev_handle: Port) -> None:
        """Have the camera begin anew, at the same address."""
        dev_handle.require().power_up()


def _put(data: bytes | memoryview, buffer: array.array) -> int:
    taken = data[: len(buffer)]
    with memoryview(buffer) as view:
        view[: len(taken)] = taken
    return len(taken)
