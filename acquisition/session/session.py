"""One armed run of a rig: arm every camera, fire the trigger, write what they send, stop them."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Protocol

from acquisition.devices.protocol import Block
from acquisition.errors import DeviceError
from acquisition.progress import Progress, silent
from acquisition.recording.manifest import Gap, Trigger
from acquisition.recording.writer import RecordingWriter, StreamWriter
from acquisition.spikes.layout import PlaneLayout

READ_TIMEOUT_S = 1.0
SILENT_READS = 5  # so many reads without a byte are a camera that has stopped sending
_REPORT_S = 0.2


class SessionCamera(Protocol):
    """What a session needs of a camera; `acquisition.devices.usb.UsbCamera` is one."""

    id: str
    layout: PlaneLayout

    def arm(self) -> None:
        """Get ready for the trigger, and confirm it."""
        ...

    def read_block(self, timeout_s: float) -> Block | None:
        """The next whole block, or None."""
        ...

    def ensure_stopped(self) -> None:
        """Stop sending, whatever it was doing."""
        ...


class TriggerLine(Protocol):
    """What starts armed cameras; `kind` goes into the manifest."""

    @property
    def kind(self) -> Trigger:
        """How the cameras are started."""
        ...

    def fire(self) -> None:
        """Start every armed camera."""
        ...


def record_session(
    cameras: Sequence[SessionCamera],
    trigger: TriggerLine,
    planes: int,
    recording: RecordingWriter,
    progress: Progress = silent,
) -> list[StreamWriter]:
    """Record `planes` planes of every camera into `recording`, which stays to be committed; a thread a camera.

    Raises DeviceError naming the camera that failed, after all others were stopped too.
    """
    rate = recording.rig.tick_rate_hz
    captures = [_Capture(camera, recording.stream(camera.id, camera.layout), planes, rate) for camera in cameras]
    stop = threading.Event()
    with ThreadPoolExecutor(len(captures)) as pool:
        try:
            for camera in cameras:
                camera.arm()
            tasks = [pool.submit(capture.run, trigger.kind, stop) for capture in captures]
            trigger.fire()
            _watch(tasks, captures, progress)
        finally:
            stop.set()
            for camera in cameras:
                camera.ensure_stopped()
    return [capture.writer for capture in captures]


def _watch(tasks: list[Future[None]], captures: list[_Capture], progress: Progress) -> None:
    """Report until all are done; raise what the first one to fail raised."""
    total = sum(capture.planes for capture in captures)
    waiting = set(tasks)
    while waiting:
        done, waiting = wait(waiting, _REPORT_S, FIRST_EXCEPTION)
        for task in done:
            task.result()
        written = sum(capture.writer.planes for capture in captures)
        progress(written / total, f"{written // len(captures)} of {captures[0].planes} planes")


@dataclass(frozen=True, eq=False)
class _Capture:
    """One camera on its way to its file."""

    camera: SessionCamera
    writer: StreamWriter
    planes: int
    tick_rate_hz: float

    def run(self, trigger: Trigger, stop: threading.Event) -> None:
        """Read and write until all planes are there or `stop` is set."""
        silent_reads = dropped = 0
        try:
            while self.writer.planes < self.planes and not stop.is_set():
                block = self.camera.read_block(READ_TIMEOUT_S)
                silent_reads = 0 if block else silent_reads + 1
                if silent_reads == SILENT_READS:
                    found = f"found no data for {SILENT_READS} reads after {self.writer.planes} of {self.planes} planes"
                    raise DeviceError(f"{self.camera.id}: {found}, expected blocks; check its cable and trigger")
                if block:
                    if self.writer.planes == 0:
                        self.writer.skew_s = self._skew_s(block, trigger)
                    dropped = self._write(block, dropped)
        finally:
            self.writer.close()

    def _skew_s(self, block: Block, trigger: Trigger) -> float | None:
        """How far the camera's plane 0 began after the trigger pulse that set its clock to zero."""
        if trigger == "software":
            return None
        return block.device_time_ns * 1e-9 - block.first_plane / self.tick_rate_hz

    def _write(self, block: Block, dropped: int) -> int:
        if block.layout != self.writer.layout:
            found = f"found planes of {block.layout}, expected {self.writer.layout}"
            raise DeviceError(f"{self.camera.id}: {found}; reconnect it")
        lost = block.first_plane - self.writer.planes
        if lost < 0:
            raise DeviceError(
                f"{self.camera.id}: found plane {block.first_plane} again, expected {self.writer.planes}; reconnect it"
            )
        lost = min(lost, self.planes - self.writer.planes)
        self.writer.append_lost(_gaps(self.writer.planes, lost, block.dropped_planes - dropped))
        self.writer.append(block.packed[: self.planes - self.writer.planes])
        return block.dropped_planes


def _gaps(first: int, lost: int, dropped_by_device: int) -> list[Gap]:
    """The device says how many of the lost planes it dropped itself; the others were lost on the link."""
    device = min(lost, max(0, dropped_by_device))
    gaps = []
    if device:
        gaps.append(Gap(first, device, "device"))
    if lost > device:
        gaps.append(Gap(first + device, lost - device, "link"))
    return gaps
