"""Finds the USB device behind a camera, and holds its pipe and its control channel; errors name the camera."""

import contextlib
import errno
from collections.abc import Iterable, Iterator
from typing import Any, cast

import usb.core
import usb.util
from usb.backend import IBackend

from acquisition.devices import sysfs
from acquisition.devices.control_channel import MessageChannel, RequestChannel
from acquisition.devices.libusb_pipe import LibusbPipe
from acquisition.devices.profile import Profile, profiles
from acquisition.devices.profiles.direct import DIRECT
from acquisition.devices.stream import BulkStream, StreamingBackend
from acquisition.errors import DeviceError
from rigs.camera import Camera

_ADVICE = {
    errno.ENODEV: ("it is not connected any more", "check its cable and power"),
    errno.EACCES: ("access was denied", "install docker/70-spike4dgs.rules"),
    errno.EBUSY: ("another program holds it", "stop that program"),
    errno.EIO: ("the transfer failed on the wire", "change its cable or port"),
}


class CameraSetupError(DeviceError):
    """A rig and the cameras that are connected do not fit together."""

    exit_code = 2


class UsbLink:
    """The device with the camera's serial, configured and held.

    It may become another device when the camera is reset or plugged in anew: `close`, then `attach` again. Raises
    CameraSetupError where there is none.
    """

    transfers: BulkStream
    control: RequestChannel | MessageChannel
    profile: Profile

    def __init__(self, camera: Camera, backend: IBackend):
        self.camera = camera
        self._backend = backend
        self.attach()

    def attach(self) -> None:
        """Find the device on the bus by its serial, configure it and hold its pipes."""
        self._device = device = find_camera(self.camera, self._backend)
        self.profile = device_profile(device) or DIRECT
        try:
            with self.named():
                device.set_configuration()
                if isinstance(self._backend, StreamingBackend):
                    pipe = self._backend.open_stream(device)
                else:
                    pipe = LibusbPipe(cast(int, device.bus), cast(int, device.address), self.profile)
        except DeviceError:
            usb.util.dispose_resources(device)
            raise
        self.transfers = BulkStream(pipe, self.profile.in_flight)
        has_messages = self.profile.command_endpoint
        self.control = MessageChannel(pipe, self.profile) if has_messages else RequestChannel(device)

    def reset(self) -> None:
        """Reset the device by the host's port; it is closed, and may come back as another one."""
        self.close()
        with self.named():
            self._device.reset()

    def close(self) -> None:
        """Give the device back."""
        self.transfers.close()
        usb.util.dispose_resources(self._device)

    @contextlib.contextmanager
    def named(self) -> Iterator[None]:
        """Raise USB errors of the block as DeviceErrors that name the camera."""
        try:
            yield
        except usb.core.USBError as error:
            raise self._failed(error) from error

    def _failed(self, error: usb.core.USBError) -> DeviceError:
        where = f"{self.camera.id} (serial {self.camera.serial})"
        if error.errno == errno.ENOMEM:
            limit = sysfs.usbfs_memory_mb()
            found = (
                f"found the kernel's memory for USB transfers full at {'its limit' if limit is None else f'{limit} MB'}"
            )
            do = f"write {sysfs.RECOMMENDED_USBFS_MB} to {sysfs.SYSFS / sysfs.USBFS_MEMORY}"
            return DeviceError(found, f"{self.profile.queued_mb:g} MB a camera", do, where=where)
        found, do = _ADVICE.get(error.errno or 0, (str(error.strerror), "reconnect it"))
        return DeviceError(found, do=do, where=where)


def find_camera(camera: Camera, backend: IBackend) -> usb.core.Device:
    """Return the device with the camera's serial, of any profile; raises CameraSetupError where there is none."""
    if not camera.serial:
        raise CameraSetupError("found no serial in the rig", "the one on the camera", "add it", where=camera.id)
    devices = usb.core.find(find_all=True, backend=backend, custom_match=device_profile)
    serials = []
    for device in cast(Iterable[usb.core.Device], devices or ()):
        serial = serial_of(device)
        if serial == camera.serial:
            return device
        serials.append(serial)
    connected = ", ".join(sorted(serials)) or "none"
    found = f"found no camera with serial {camera.serial} (connected: {connected})"
    raise CameraSetupError(found, do="check its cable and power", where=camera.id)


def serial_of(device: usb.core.Device) -> str:
    """Return the serial number of a device, or that it cannot be read."""
    try:
        return str(device.serial_number)
    except (usb.core.USBError, ValueError):  # one that may not be opened; a serial is only needed from ours
        return "unreadable"


def device_profile(device: usb.core.Device) -> Profile | None:
    """Return the profile of a device on the bus; None for one that is no camera."""
    found = cast(Any, device)  # pyusb sets the fields of its descriptor at run time
    known = {(profile.vendor_id, profile.product_id): profile for profile in profiles().values()}
    return known.get((found.idVendor, found.idProduct))
