"""What `calibrate --pixels` does: measure the cameras' pixels and write their maps beside the rig file."""

import dataclasses
import json
from pathlib import Path

import click
import numpy as np

from acquisition.durable import write_durably
from acquisition.errors import BadRecordingError
from acquisition.recording.reader import Recording
from reconstruction.images.pixels import PixelCalibration, estimate_pixels, write_pixels
from rigs.toml import dump_rig
from server.cli.progress import progress_of


def calibrate_pixels(recording: Path, pixels: tuple[Path, Path], out: Path, *, as_json: bool) -> None:
    """Measure the pixels of the cameras of `recording` from a flat and a dark one; write the rig file `out`."""
    rig = Recording.open(recording).rig
    flat, dark = map(Recording.open, pixels)
    progress, found = progress_of("calibrate"), {}
    for number, camera in enumerate(rig.cameras):
        progress(number / len(rig.cameras), camera.id)
        found[camera.id] = _estimate(camera.id, (camera.width, camera.height), flat, dark)
    out.parent.mkdir(parents=True, exist_ok=True)
    cameras = []
    for camera in rig.cameras:
        path = out.with_name(f"{out.stem}-{camera.id}-pixels.npz")
        write_pixels(path, found[camera.id])
        cameras.append(dataclasses.replace(camera, pixels=path))
    write_durably(out, dump_rig(dataclasses.replace(rig, cameras=tuple(cameras))))
    progress(1.0, f"{len(cameras)} cameras")
    rows = {camera_id: _summary(calibration) for camera_id, calibration in found.items()}
    if as_json:
        click.echo(json.dumps({"rig": str(out), "cameras": rows}))
        return
    for camera_id, row in rows.items():
        click.echo(
            f"{camera_id}: gain spread {row['gain_spread']:.2%}, mean offset {row['mean_offset']:.5f} spikes per tick, "
            f"{row['hot']} hot, {row['dead']} dead"
        )


def _estimate(camera_id: str, size: tuple[int, int], flat: Recording, dark: Recording) -> PixelCalibration:
    streams = []
    for recording in (flat, dark):
        try:
            streams.append(recording.stream(camera_id))
        except BadRecordingError as error:
            raise BadRecordingError(f"{recording.path}: {error}") from error
    found = streams[0].layout.width, streams[0].layout.height
    if found != size:
        raise BadRecordingError(
            f"{camera_id}: found {found[0]}x{found[1]} pixels", f"{size[0]}x{size[1]} as in REC", where=flat.path
        )
    try:
        return estimate_pixels(*streams)
    except BadRecordingError as error:
        raise BadRecordingError(f"{camera_id}: {error}") from error


def _summary(calibration: PixelCalibration) -> dict[str, float]:
    good = ~calibration.defect
    return {
        "gain_spread": float(calibration.gain[good].std()),
        "mean_offset": float(np.mean(calibration.offset[good])),
        "hot": int(calibration.hot.sum()),
        "dead": int(calibration.dead.sum()),
    }
