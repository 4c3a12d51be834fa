"""The driver of one spike camera over its USB link; the same on every backend."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from usb.backend import IBackend

from acquisition.devices.profile import Profile
from acquisition.devices.protocol import Block, BlockParser
from acquisition.devices.registers import (
    PROTOCOL_VERSION,
    ClockRegister,
    Geometry,
    Identity,
    Register,
    Request,
    Sensitivity,
    State,
    Status,
    TickRate,
)
from acquisition.devices.usb_link import CameraSetupError, UsbLink
from acquisition.errors import DeviceError
from acquisition.recording.manifest import Trigger
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera

R = TypeVar("R", bound=Register)
_LATCHES = 3


@dataclass(frozen=True)
class ClockLatch:
    """A camera's clock read at `host_s` on the host's, which is right to `uncertainty_s`, half the round trip.

    `oscillator_s` counts from the camera's power-up, `run_s` from the trigger (None where it does not run).
    """

    host_s: float
    oscillator_s: float
    run_s: float | None
    uncertainty_s: float


class CameraRegisters:
    """Reads a camera's registers and gives it commands."""

    def __init__(self, link: UsbLink):
        self._link = link

    def read(self, kind: type[R]) -> R:
        """Return the register of this class as it is now."""
        with self._link.named():
            data = self._link.control.read(kind.REQUEST)
        try:
            return kind.decode(data)
        except DeviceError as error:
            raise DeviceError.at(self._link.camera.id, error) from error

    def command(self, request: Request, data: bytes = b"") -> None:
        """Have the camera do `request`."""
        with self._link.named():
            self._link.control.write(request, data)

    def latch(self) -> ClockLatch:
        """Read the camera's clock against the host's: the quickest of three readings."""
        found = []
        for _ in range(_LATCHES):
            before_s = time.monotonic()
            register = self.read(ClockRegister)
            half_s = (time.monotonic() - before_s) / 2
            run_s = None if register.trigger_ns is None else (register.now_ns - register.trigger_ns) * 1e-9
            found.append(ClockLatch(before_s + half_s, register.now_ns * 1e-9, run_s, half_s))
        return min(found, key=lambda latch: latch.uncertainty_s)

    def set_sensitivity(self, wanted: Sensitivity) -> None:
        """Set threshold and exposure of an idle camera, and confirm them; raises DeviceError for wild values."""
        where = self._link.camera.id
        try:
            wanted.refuse_wild()
        except DeviceError as error:
            raise CameraSetupError(error.found, error.expected, "choose another value", where=where) from error
        self.command(Request.SET_SENSITIVITY, wanted.encode())
        found = self.read(Sensitivity)
        if found != wanted:
            raise DeviceError(f"found {found} after setting it", str(wanted), "update its firmware", where=where)


class UsbCamera:
    """A connected camera that is the rig's `camera`. Every error is a DeviceError that names it. Build with `open`.

    `layout` is how a plane lies in bytes. Since `ensure_ready`, `parser` counts the damaged stretches of the stream.
    """

    layout: PlaneLayout
    parser: BlockParser

    def __init__(self, link: UsbLink):
        self.id, self.serial = link.camera.id, link.camera.serial
        self._link = link
        self.registers = CameraRegisters(link)
        self._learn_geometry()

    @classmethod
    def open(cls, camera: Camera, tick_rate_hz: float, backend: IBackend) -> UsbCamera:
        """Open the device with the camera's serial, checked against the rig.

        Raises CameraSetupError when it is missing or has another version, size or tick rate.
        """
        link = UsbLink(camera, backend)
        try:
            opened = cls(link)
            opened._check(camera, tick_rate_hz)
        except DeviceError:
            link.close()
            raise
        return opened

    @property
    def profile(self) -> Profile:
        """Return the kind of device that the camera is."""
        return self._link.profile

    def ensure_ready(self, *, joins: bool = False) -> None:
        """Arm the camera and confirm it; `joins`: the trigger may have come already, from a line that pulses."""
        self.parser = BlockParser(self._block_bytes)
        with self._link.named():
            self._link.transfers.stop()  # those of an earlier run
        self.registers.command(Request.ARM)
        state = self.registers.read(Status).state
        if state is not State.ARMED and not (joins and state is State.RUNNING):
            raise DeviceError(f"found it {state.name.lower()} after arming", "armed", "reconnect it", where=self.id)
        with self._link.named():
            self._link.transfers.start()

    def start_acquiring(self) -> None:
        """Start an armed camera without a trigger line."""
        self.registers.command(Request.START)

    def read_block(self, timeout_s: float) -> Block | None:
        """Return the next whole block, or None when `timeout_s` passed without new bytes, or with damage alone."""
        until_s, skipped_bytes = time.monotonic() + timeout_s, self.parser.skipped_bytes
        while not (found := self.parser.next()):
            if self.parser.skipped_bytes > skipped_bytes and time.monotonic() > until_s:
                return None
            with self._link.named():
                data = self._link.transfers.read(timeout_s)
            if not data:
                return None
            self.parser.feed(data)
        return found

    def ensure_stopped(self) -> None:
        """Stop sending, whatever the camera was doing; one that is gone has stopped."""
        with contextlib.suppress(DeviceError):
            self.registers.command(Request.STOP)

    def reset(self) -> None:
        """Reset the camera by the host's port, as when it hangs; `reopen` it then."""
        self._link.reset()

    def reopen(self) -> None:
        """Find the camera on the bus again, by its serial, after a reset or when it was plugged in anew.

        Raises CameraSetupError while it is not there, DeviceError for one that is another camera than before.
        """
        self._link.close()
        before = self.layout
        self._link.attach()
        try:
            self._learn_geometry()
            if self.layout != before:
                found = f"found planes of {self.layout}"
                raise DeviceError(found, f"{before} as before", "reconnect it", where=self.id)
        except DeviceError:
            self._link.close()
            raise

    def close(self) -> None:
        """Give the device back."""
        self._link.close()

    def _learn_geometry(self) -> None:
        """Ask the camera how its planes and blocks lie in bytes."""
        geometry = self.registers.read(Geometry)
        self.layout = geometry.layout
        self._block_bytes = geometry.planes_per_block * geometry.layout.plane_bytes
        self.parser = BlockParser(self._block_bytes)

    def _check(self, camera: Camera, tick_rate_hz: float) -> None:
        version = self.registers.read(Identity).protocol_version
        size, wanted = f"{self.layout.width}x{self.layout.height}", f"{camera.width}x{camera.height}"
        if version != PROTOCOL_VERSION:
            raise CameraSetupError(
                f"found protocol {version}", str(PROTOCOL_VERSION), "update one of them", where=self.id
            )
        if size != wanted:
            raise CameraSetupError(f"found a sensor of {size}", wanted, "mend the rig", where=self.id)
        rate_hz = self.registers.read(TickRate).hz
        if abs(rate_hz - tick_rate_hz) > 1e-3:
            raise CameraSetupError(f"found {rate_hz:g} Hz", f"{tick_rate_hz:g} Hz", "mend the rig", where=self.id)


class SoftwareTrigger:
    """Starts cameras one after another over USB, for a rig without a trigger line: their skew is not known."""

    kind: Trigger = "software"
    period_s: float | None = None

    def __init__(self, cameras: Sequence[UsbCamera]):
        self._cameras = cameras

    def fire(self) -> None:
        """Start all."""
        for camera in self._cameras:
            camera.start_acquiring()
