"""The driver of one spike camera: pyusb for control, transfers in flight for the stream; the same on every backend."""

from __future__ import annotations

import contextlib
import errno
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, cast

import usb.core
import usb.util
from usb.backend import IBackend

from acquisition.devices.control_channel import MessageChannel, RequestChannel
from acquisition.devices.discovery import CameraSetupError, device_profile, find_camera
from acquisition.devices.libusb_pipe import LibusbPipe
from acquisition.devices.profiles.direct import DIRECT
from acquisition.devices.protocol import Block, BlockParser, Damage, RepeatFilter
from acquisition.devices.registers import (
    PROTOCOL_VERSION,
    ClockRegister,
    Geometry,
    Identity,
    LinkCounters,
    Request,
    Sensitivity,
    State,
    Status,
    decode_tick_rate,
)
from acquisition.devices.stream import RECOMMENDED_USBFS_MB, BulkStream, StreamingBackend
from acquisition.errors import DeviceError
from acquisition.recording.manifest import Trigger
from rigs.camera import Camera

_USBFS_MB = Path("/sys/module/usbcore/parameters/usbfs_memory_mb")
_LATCHES = 3
_ADVICE = {
    errno.ENODEV: ("it is not connected any more", "check its cable and power"),
    errno.EACCES: ("access was denied", "allow this user to open the device (a udev rule)"),
    errno.EBUSY: ("another program holds it", "stop that program"),
    errno.EIO: ("the transfer failed on the wire", "change its cable or port"),
}


class ClockLatch(NamedTuple):
    """A camera's clock read at `host_s` on the host's, which is right to `uncertainty_s`, half the round trip.

    `oscillator_s` counts from the camera's power-up, `run_s` from the trigger (None where it does not run).
    """

    host_s: float
    oscillator_s: float
    run_s: float | None
    uncertainty_s: float


class UsbCamera:
    """A connected camera that is the rig's `camera`. Every error is a DeviceError that names it. Build with `open`.

    `damages` counts the damaged stretches of the stream since it was armed, `repeats` the blocks that came twice.
    """

    def __init__(self, camera: Camera, device: usb.core.Device, backend: IBackend):
        self.id = camera.id
        self.serial = camera.serial
        self.damages = 0
        self._camera, self._backend, self._device = camera, backend, device
        self._repeated = RepeatFilter()
        self.profile = device_profile(device) or DIRECT
        self._attach()

    def _attach(self) -> None:
        """Configure the device, hold its pipes and learn its geometry."""
        device = self._device
        with self._named():
            device.set_configuration()
            if isinstance(self._backend, StreamingBackend):
                pipe = self._backend.open_stream(device)
            else:
                pipe = LibusbPipe(cast(int, device.bus), cast(int, device.address), self.profile)
        self._stream = BulkStream(pipe, self.profile.in_flight)
        messages = self.profile.command_endpoint
        self._control = MessageChannel(pipe, self.profile) if messages else RequestChannel(device)
        try:
            geometry = Geometry.decode(self._register(Request.GEOMETRY))
        except DeviceError:
            self._stream.close()
            raise
        self.layout = geometry.layout
        self._block_bytes = geometry.planes_per_block * geometry.layout.plane_bytes
        self._parser = BlockParser(self._block_bytes)

    @property
    def repeats(self) -> int:
        """Blocks that came twice, and were left out."""
        return self._repeated.repeats

    @classmethod
    def open(cls, camera: Camera, tick_rate_hz: float, backend: IBackend) -> UsbCamera:
        """The device with the camera's serial, checked against the rig.

        Raises CameraSetupError when it is missing or has another version, size or tick rate.
        """
        device = find_camera(camera, backend)
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

    def arm(self, *, joins: bool = False) -> None:
        """Get ready for the trigger, and confirm it; `joins`: it may have come already, from a line that pulses."""
        self._parser, self._repeated = BlockParser(self._block_bytes), RepeatFilter()
        self.damages = 0
        with self._named():
            self._stream.stop()
        self._command(Request.ARM)
        state = self.status().state
        if state is not State.ARMED and not (joins and state is State.RUNNING):
            raise DeviceError(f"found it {state.name.lower()} after arming", "armed", "reconnect it", where=self.id)
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

    def sensitivity(self) -> Sensitivity:
        """The threshold and the exposure."""
        return Sensitivity.decode(self._register(Request.SENSITIVITY))

    def set_sensitivity(self, wanted: Sensitivity) -> None:
        """Set threshold and exposure of an idle camera, and confirm them; raises DeviceError for wild values."""
        try:
            wanted.refuse_wild()
        except DeviceError as error:
            raise CameraSetupError(error.found, error.expected, "choose another value", where=self.id) from error
        self._command(Request.SET_SENSITIVITY, wanted.encode())
        found = self.sensitivity()
        if found != wanted:
            raise DeviceError(f"found {found} after setting it", f"{wanted}", "update its firmware", where=self.id)

    def link_counters(self) -> LinkCounters:
        """What its end of the link has counted since it was powered up."""
        return LinkCounters.decode(self._register(Request.LINK))

    def latch(self, clock: Callable[[], float] = time.monotonic) -> ClockLatch:
        """Its clock against the host's, the quickest of three requests."""
        found = []
        for _ in range(_LATCHES):
            before_s = clock()
            register = ClockRegister.decode(self._register(Request.CLOCK))
            half_s = (clock() - before_s) / 2
            run_s = None if register.trigger_ns is None else (register.now_ns - register.trigger_ns) * 1e-9
            found.append(ClockLatch(before_s + half_s, register.now_ns * 1e-9, run_s, half_s))
        return min(found, key=lambda latch: latch.uncertainty_s)

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

    def reset(self) -> None:
        """Reset it by the host's port, as when it hangs; `reopen` it then. It may come back as another device."""
        self.close()
        with self._named():
            self._device.reset()

    def reopen(self) -> None:
        """Find it on the bus again, by its serial, after a reset or when it was plugged in anew.

        Raises CameraSetupError while it is not there, DeviceError for one that is another camera than before.
        """
        self.close()
        before = self.layout
        self._device = find_camera(self._camera, self._backend)
        self._attach()
        if self.layout != before:
            self.close()
            raise DeviceError(f"found planes of {self.layout}", f"{before} as before", "reconnect it", where=self.id)

    def close(self) -> None:
        """Give the device back."""
        self._stream.close()
        usb.util.dispose_resources(self._device)

    def _check(self, camera: Camera, tick_rate_hz: float) -> None:
        version = self.identity().protocol_version
        if version != PROTOCOL_VERSION:
            raise CameraSetupError(
                f"found protocol {version}", f"{PROTOCOL_VERSION}", "update one of them", where=self.id
            )
        if (self.layout.width, self.layout.height) != (camera.width, camera.height):
            found = f"{self.layout.width}x{self.layout.height}"
            raise CameraSetupError(
                f"found a sensor of {found}", f"{camera.width}x{camera.height}", "mend the rig", where=self.id
            )
        rate = decode_tick_rate(self._register(Request.TICK_RATE))
        if abs(rate - tick_rate_hz) > 1e-3:
            raise CameraSetupError(f"found {rate:g} Hz", f"{tick_rate_hz:g} Hz", "mend the rig", where=self.id)

    def _receive(self, timeout_s: float) -> bool:
        with self._named():
            data = self._stream.read(timeout_s)
        self._parser.feed(data)
        return len(data) > 0

    def _register(self, request: Request) -> bytes:
        with self._named():
            return self._control.read(request)

    def _command(self, request: Request, data: bytes = b"") -> None:
        with self._named():
            self._control.write(request, data)

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except usb.core.USBError as error:
            raise self._failed(error) from error

    def _failed(self, error: usb.core.USBError) -> DeviceError:
        where = f"{self.id} (serial {self.serial})"
        if error.errno == errno.ENOMEM:
            limit = f"{_USBFS_MB.read_text().strip()} MB" if _USBFS_MB.exists() else "its limit"
            found, do = (
                f"found the kernel's memory for USB transfers full at {limit}",
                f"write {RECOMMENDED_USBFS_MB} to",
            )
            return DeviceError(found, f"{self.profile.queued_mb:g} MB a camera", f"{do} {_USBFS_MB}", where=where)
        found, do = _ADVICE.get(error.errno or 0, (str(error.strerror), "reconnect it"))
        return DeviceError(found, do=do, where=where)


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
