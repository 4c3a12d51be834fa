"""The driver of one spike camera: pyusb for control, transfers in flight for the stream; the same on every backend."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import cast

import usb.core
import usb.util
from usb.backend import IBackend

from acquisition.devices.libusb_pipe import LibusbPipe
from acquisition.devices.protocol import Block, BlockParser, Damage, RepeatFilter
from acquisition.devices.registers import (
    PRODUCT_ID,
    PROTOCOL_VERSION,
    REGISTER_BYTES,
    VENDOR_ID,
    Geometry,
    Identity,
    Request,
    State,
    Status,
    decode_tick_rate,
)
from acquisition.devices.stream import IN_FLIGHT, RECOMMENDED_USBFS_MB, BulkStream, StreamingBackend
from acquisition.errors import DeviceError
from acquisition.recording.manifest import Trigger
from rigs.camera import Camera

_USBFS_MB = Path("/sys/module/usbcore/parameters/usbfs_memory_mb")
_CONTROL_TIMEOUT_MS = 1000
_READ_REGISTER = usb.util.CTRL_IN | usb.util.CTRL_TYPE_VENDOR | usb.util.CTRL_RECIPIENT_DEVICE
_COMMAND = usb.util.CTRL_OUT | usb.util.CTRL_TYPE_VENDOR | usb.util.CTRL_RECIPIENT_DEVICE
_ADVICE = {
    errno.ENODEV: "it is not connected any more; check its cable and power",
    errno.EACCES: "access was denied; allow this user to open the device (a udev rule)",
    errno.EBUSY: "another program holds it; stop that program",
    errno.EIO: "the transfer failed on the wire; change its cable or port",
}


class CameraSetupError(DeviceError):
    """A rig and the cameras that are connected do not fit together."""

    exit_code = 2


class UsbCamera:
    """A connected camera that is the rig's `camera`. Every error is a DeviceError that names it. Build with `open`.

    `damages` counts the damaged stretches of the stream since it was armed, `repeats` the blocks that came twice.
    """

    def __init__(self, camera: Camera, device: usb.core.Device, backend: IBackend):
        self.id = camera.id
        self.serial = camera.serial
        self.damages = 0
        self._device = device
        self._repeated = RepeatFilter()
        with self._named():
            device.set_configuration()
        geometry = Geometry.decode(self._register(Request.GEOMETRY))
        self.layout = geometry.layout
        self._block_bytes = geometry.planes_per_block * geometry.layout.plane_bytes
        self._parser = BlockParser(self._block_bytes)
        with self._named():
            own = isinstance(backend, StreamingBackend)
            pipe = backend.open_stream(device) if own else LibusbPipe(cast(int, device.bus), cast(int, device.address))
        self._stream = BulkStream(pipe)

    @property
    def repeats(self) -> int:
        """Blocks that came twice, and were left out."""
        return self._repeated.repeats

    @classmethod
    def open(cls, camera: Camera, tick_rate_hz: float, backend: IBackend) -> UsbCamera:
        """The device with the camera's serial, checked against the rig.

        Raises CameraSetupError when it is missing or has another version, size or tick rate.
        """
        device = _find(camera, backend)
        try:
            opened = cls(camera, device, backend)
        except DeviceError:
            usb.util.dispose_resources(device)
            raise
        try:
            opened._check(camera, tick_rate_hz)
        except DeviceError:
            opened.close()
            raise
        return opened

    def arm(self) -> None:
        """Get ready for the trigger, and confirm it."""
        self._parser, self._repeated = BlockParser(self._block_bytes), RepeatFilter()
        self.damages = 0
        with self._named():
            self._stream.stop()
        self._command(Request.ARM)
        state = self.status().state
        if state is not State.ARMED:
            raise DeviceError(f"{self.id}: found it {state.name.lower()} after arming, expected armed; reconnect it")
        with self._named():
            self._stream.start()

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
                if self._repeated.is_repeat(found):
                    continue
                return found
            if not isinstance(found, Damage) and not self._receive(timeout_s):
                return None

    def ensure_stopped(self) -> None:
        """Stop sending, whatever it was doing; a camera that is gone has stopped."""
        with contextlib.suppress(DeviceError):
            self._command(Request.STOP)

    def close(self) -> None:
        """Give the device back."""
        self._stream.close()
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
        with self._named():
            data = self._stream.read(timeout_s)
        self._parser.feed(data)
        return len(data) > 0

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
        if error.errno == errno.ENOMEM:
            return DeviceError(f"{self.id} (serial {self.serial}): {_usbfs_advice()}")
        advice = _ADVICE.get(error.errno or 0, f"{error.strerror}; reconnect it")
        return DeviceError(f"{self.id} (serial {self.serial}): {advice}")


class SoftwareTrigger:
    """Starts cameras one after another over USB, for a rig without a trigger line: their skew is not known."""

    kind: Trigger = "software"
    period_s: float | None = None

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


def _usbfs_advice() -> str:
    limit = f"{_USBFS_MB.read_text().strip()} MB" if _USBFS_MB.exists() else "its limit"
    return (
        f"found the kernel's memory for USB transfers full at {limit}, expected {IN_FLIGHT} MB a camera; "
        f"write {RECOMMENDED_USBFS_MB} to {_USBFS_MB}"
    )


def _serial_of(device: usb.core.Device) -> str:
    try:
        return str(device.serial_number)
    except (usb.core.USBError, ValueError):  # one that may not be opened; a serial is only needed from ours
        return "unreadable"
