"""A whole recording: cameras opened by a URI, one armed run, the truth where it is known, a named folder."""

from __future__ import annotations

from pathlib import Path

from acquisition.devices.open import Simulation, open_cameras, parse_devices
from acquisition.errors import BadRecordingError
from acquisition.progress import Progress, silent
from acquisition.recording.manifest import TRUTH_FOLDER, Manifest
from acquisition.recording.writer import RecordingWriter, disk_errors
from acquisition.scenes.truth import write_truth
from acquisition.session.session import record_session
from acquisition.spikes.layout import PlaneLayout
from rigs.rig import Rig

_TRUTH_BYTES_PER_PIXEL = 16  # light, depth, object, blur
_RECORDING_SHARE, _WRITTEN = 0.8, 0.99  # of the work: after the planes where truth follows them, before the name


def record(rig: Rig, devices: str, planes: int, out: Path, progress: Progress = silent) -> Manifest:
    """Record `planes` planes of every camera of `rig`, opened by the URI `devices`, as the folder `out`.

    Raises DeviceError naming the camera that failed, DiskError for a full disk; then nothing is left under `out`.
    """
    return _record(rig, parse_devices(devices), planes, out, progress)


def simulate(simulation: Simulation, rig: Rig, ticks: int, out: Path, progress: Progress = silent) -> Manifest:
    """`record` with simulated cameras."""
    return _record(rig, simulation, ticks, out, progress)


def _record(rig: Rig, devices: Simulation | None, planes: int, out: Path, progress: Progress) -> Manifest:
    if planes < 1:
        raise BadRecordingError(f"found {planes} ticks, expected at least 1")
    share = _RECORDING_SHARE if devices else _WRITTEN
    with RecordingWriter(out, rig, _needed_bytes(rig, devices, planes)) as recording:
        with open_cameras(rig, devices, planes) as opened:
            streams = record_session(opened.cameras, opened.trigger, planes, recording, _part(progress, 0.0, share))
        if devices and opened.scene:
            every, folder = devices.truth_every, recording.folder / TRUTH_FOLDER
            with disk_errors(folder):
                report = _part(progress, share, _WRITTEN)
                write_truth(opened.scene, rig, planes, every, folder, report, sensor=devices.sensor)
        manifest = recording.commit([stream.entry() for stream in streams], opened.trigger.kind)
    progress(1.0, f"{len(streams)} cameras, {planes} planes each")
    return manifest


def _needed_bytes(rig: Rig, devices: Simulation | None, planes: int) -> int:
    spikes = planes * sum(PlaneLayout(camera.width, camera.height).plane_bytes for camera in rig.cameras)
    instants = -(-planes // devices.truth_every) if devices else 0
    return spikes + instants * _TRUTH_BYTES_PER_PIXEL * sum(camera.width * camera.height for camera in rig.cameras)


def _part(progress: Progress, first: float, last: float) -> Progress:
    """Report a part of the work as [first, last] of the whole."""

    def report(fraction: float, message: str) -> None:
        progress(first + fraction * (last - first), message)

    return report
