"""The driver of one spike camera over pyusb; the same on libusb and on the mock."""

from __future__ import annotations

import array
import contextlib
import errno
from collections.abc import Iterable, Iterator, Sequence
from typing import cast

import usb.core
import usb.util
from usb.backend import IBackend

from acquisition.devices.protocol import (
    PRODUCT_ID,
    PROTOCOL_VERSION,
    REGISTER_BYTES,
    STREAM_ENDPOINT,
    VENDOR_ID,
    Block,
    BlockParser,
    Damage,
    Geometry,
    Identity,
    Request,
    State,
    Status,
    decode_tick_rate,
)
from acquisition.errors import DeviceError
from acquisition.recording.manifest import Trigger
from rigs.camera import Camera

_TRANSFER_BYTES = 1 << 20
_CONTROL_TIMEOUT_MS = 1000
_READ_REGISTER = usb.util.CTRL_IN | usb.util.CTRL_TYPE_VENDOR | usb.util.CTRL_RECIPIENT_DEVICE
_COMMAND = usb.util.CTRL_OUT | usb.util.CTRL_TYPE_VENDOR | usb.util.CTRL_RECIPIENT_DEVICE
_ADVICE = {
    errno.ENODEV: "it is not connected any more; check its cable and power",
    errno.EACCES: "access was denied; allow this user to open the device (a udev rule)",
    errno.EBUSY: "another program holds it; stop that program",
    errno.ENOMEM: "the kernel has no memory left for transfers; raise usbcore.usbfs_memory_mb",
}


class CameraSetupError(DeviceError):
    """A rig and the cameras that are connected do not fit together."""

    exit_code = 2


class UsbCamera:
    """A connected camera that is the rig's `camera`. Every error is a DeviceError that names it. Build with `open`."""

    def __init__(self, camera: Camera, device: usb.core.Device):
        self.id = camera.id
        self.serial = camera.serial
        self.damages = 0
        self._device = device
        self._parser = BlockParser()
        self._buffer = array.array("B", bytes(_TRANSFER_BYTES))
        with self._named():
            device.set_configuration()
            usb.util.claim_interface(device, 0)
        geometry = Geometry.decode(self._register(Request.GEOMETRY))
        self.layout = geometry.layout

    @classmethod
    def open(cls, camera: Camera, tick_rate_hz: float, backend: IBackend) -> UsbCamera:
        """The device with the camera's serial, checked against the rig.

        Raises CameraSetupError when it is missing or has another version, size or tick rate.
        """
        device = _find(camera, backend)
        try:
            opened = cls(camera, device)
            opened._check(camera, tick_rate_hz)
        except DeviceError:
            usb.util.dispose_resources(device)
            raise
        return opened

    def arm(self) -> None:
        """Get ready for the trigger, and confirm it."""
        self._parser = BlockParser()
        self.damages = 0
        self._command(Request.ARM)
        state = self.status().state
        if state is not State.ARMED:
            raise DeviceError(f"{self.id}: found it {state.name.lower()} after arming, expected armed; reconnect it")

    def start(self) -> None:
        """Start without a trigger line."""
        self._command(Request.START)

    def status(self) -> Status:
        """The status register."""
        return Status.decode(self._register(Request.STATUS))

    def identity(self) -> Identity:
        """The protocol and firmware it runs."""
        return Identity.decode(self._register(Request.IDENTITY))

    def read_block(self, timeout_s: float) -> Block | None:
        """The next whole block, or None when `timeout_s` passed without new bytes; damaged ones are counted."""
        while True:
            found = self._parser.next()
            self.damages = self._parser.damages
            if isinstance(found, Block):
                return found
            if not isinstance(found, Damage) and not self._receive(timeout_s):
                return None

    def ensure_stopped(self) -> None:
        """Stop sending, whatever it was doing; a camera that is gone has stopped."""
        with contextlib.suppress(DeviceError):
            self._command(Request.STOP)

    def close(self) -> None:
        """Give the device back."""
        usb.util.dispose_resources(self._device)

    def _check(self, camera: Camera, tick_rate_hz: float) -> None:
        version = self.identity().protocol_version
        if version != PROTOCOL_VERSION:
            raise CameraSetupError(
                f"{self.id}: found protocol {version}, expected {PROTOCOL_VERSION}; update one of them"
            )
        if (self.layout.width, self.layout.height) != (camera.width, camera.height):
            found = f"{self.layout.width}x{self.layout.height}"
            raise CameraSetupError(
                f"{self.id}: found a sensor of {found}, expected {camera.width}x{camera.height}; mend the rig"
            )
        rate = decode_tick_rate(self._register(Request.TICK_RATE))
        if abs(rate - tick_rate_hz) > 1e-3:
            raise CameraSetupError(f"{self.id}: found {rate:g} Hz, expected {tick_rate_hz:g} Hz; mend the rig")

    def _receive(self, timeout_s: float) -> bool:
        try:
            count = cast(int, self._device.read(STREAM_ENDPOINT, self._buffer, max(1, round(timeout_s * 1000))))
        except usb.core.USBError as error:
            if error.errno == errno.ETIMEDOUT:
                return False
            if error.errno != errno.EPIPE:
                raise self._failed(error) from error
            with self._named():
                self._device.clear_halt(STREAM_ENDPOINT)
            return False
        with memoryview(self._buffer) as view:
            self._parser.feed(view[:count])
        return True

    def _register(self, request: Request) -> bytes:
        with self._named():
            answer = self._device.ctrl_transfer(
                _READ_REGISTER, request, 0, 0, REGISTER_BYTES[request], _CONTROL_TIMEOUT_MS
            )
        return bytes(answer)

    def _command(self, request: Request) -> None:
        with self._named():
            self._device.ctrl_transfer(_COMMAND, request, 0, 0, None, _CONTROL_TIMEOUT_MS)

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except usb.core.USBError as error:
            raise self._failed(error) from error

    def _failed(self, error: usb.core.USBError) -> DeviceError:
        advice = _ADVICE.get(error.errno or 0, f"{error.strerror}; reconnect it")
        return DeviceError(f"{self.id} (serial {self.serial}): {advice}")


class SoftwareTrigger:
    """Starts cameras one after another over USB, for a rig without a trigger line: their skew is not known."""

    kind: Trigger = "software"

    def __init__(self, cameras: Sequence[UsbCamera]):
        self._cameras = cameras

    def fire(self) -> None:
        """Start all."""
        for camera in self._cameras:
            camera.start()


def _find(camera: Camera, backend: IBackend) -> usb.core.Device:
    if not camera.serial:
        raise CameraSetupError(
            f"{camera.id}: found no serial in the rig, expected the one on the camera; add it to the rig"
        )
    devices = usb.core.find(find_all=True, backend=backend, idVendor=VENDOR_ID, idProduct=PRODUCT_ID)
    serials = []
    for device in cast(Iterable[usb.core.Device], devices or ()):
        serial = _serial_of(device)
        if serial == camera.serial:
            return device
        serials.append(serial)
    connected = ", ".join(sorted(serials)) or "none"
    raise CameraSetupError(
        f"{camera.id}: found no camera with serial {camera.serial} (connected: {connected}); check its cable and power"
    )


def _serial_of(device: usb.core.Device) -> str:
    try:
        return str(device.serial_number)
    except (usb.core.USBError, ValueError):  # one that may not be opened; a serial is only needed from ours
        return "unreadable"
