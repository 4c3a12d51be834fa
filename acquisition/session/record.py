"""A whole recording: cameras opened by a URI, one armed run, the truth where it is known, a named folder."""

from __future__ import annotations

from pathlib import Path

from acquisition.devices.open import OpenCameras, Simulated, Simulation, open_cameras, open_simulated
from acquisition.errors import BadRecordingError
from acquisition.progress import Progress, silent
from acquisition.recording.manifest import TRUTH_FOLDER, Manifest
from acquisition.recording.writer import RecordingWriter, disk_errors, refuse_taken
from acquisition.scenes.truth import write_truth
from acquisition.session.session import record_session
from rigs.rig import Rig

_TRUTH_BYTES_PER_PIXEL = 16  # light, depth, object, blur
_RECORDING_SHARE, _WRITTEN = 0.8, 0.99  # of the work: after the planes where truth follows them, before the name


def record(rig: Rig, devices: str, planes: int, out: Path, progress: Progress = silent) -> Manifest:
    """Record `planes` planes of every camera of `rig`, opened by the URI `devices`, as the folder `out`.

    Raises DeviceError naming the camera that failed, DiskError for a full disk; then nothing is left under `out`.
    """
    _check(planes, out)
    with open_cameras(rig, devices, planes) as opened:
        return _record(rig, opened, planes, out, progress)


def simulate(simulation: Simulation, rig: Rig, ticks: int, out: Path, progress: Progress = silent) -> Manifest:
    """`record` with simulated cameras."""
    _check(ticks, out)
    with open_simulated(rig, simulation, ticks) as opened:
        return _record(rig, opened, ticks, out, progress)


def _check(planes: int, out: Path) -> None:
    if planes < 1:
        raise BadRecordingError(f"found {planes} ticks, expected at least 1")
    refuse_taken(out)


def _record(rig: Rig, opened: OpenCameras, planes: int, out: Path, progress: Progress) -> Manifest:
    needed = planes * sum(camera.layout.plane_bytes for camera in opened.cameras) + _truth_bytes(rig, opened, planes)
    share = _RECORDING_SHARE if opened.simulated else _WRITTEN
    with RecordingWriter(out, rig, needed) as recording:
        streams = record_session(opened.cameras, opened.trigger, planes, recording, _part(progress, 0.0, share))
        if opened.simulated:
            _write_truth(
                opened.simulated, rig, planes, recording.folder / TRUTH_FOLDER, _part(progress, share, _WRITTEN)
            )
        manifest = recording.commit([stream.entry() for stream in streams], opened.trigger.kind)
    progress(1.0, f"{len(streams)} cameras, {planes} planes each")
    return manifest


def _write_truth(simulated: Simulated, rig: Rig, planes: int, folder: Path, progress: Progress) -> None:
    every, sensor = simulated.simulation.truth_every, simulated.simulation.sensor
    with disk_errors(folder):
        write_truth(simulated.scene, rig, planes, every, folder, progress, sensor=sensor)


def _part(progress: Progress, first: float, last: float) -> Progress:
    """Report a part of the work as [first, last] of the whole."""

    def report(fraction: float, message: str) -> None:
        progress(first + fraction * (last - first), message)

    return report


def _truth_bytes(rig: Rig, opened: OpenCameras, planes: int) -> int:
    if not opened.simulated:
        return 0
    frames = -(-planes // opened.simulated.simulation.truth_every)
    return frames * _TRUTH_BYTES_PER_PIXEL * sum(camera.width * camera.height for camera in rig.cameras)
