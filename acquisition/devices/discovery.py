"""Finds the cameras of a rig on the bus, by their serial numbers."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, cast

import usb.core
from usb.backend import IBackend

from acquisition.devices.profile import Profile, profile_of
from acquisition.errors import DeviceError
from rigs.camera import Camera


class CameraSetupError(DeviceError):
    """A rig and the cameras that are connected do not fit together."""

    exit_code = 2


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
    return profile_of(found.idVendor, found.idProduct)
