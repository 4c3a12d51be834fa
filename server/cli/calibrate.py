"""`calibrate` measures the cameras of a rig; `check-rig` compares a stored calibration with a recording."""

import dataclasses
import datetime
from collections.abc import Mapping
from pathlib import Path

import click
import numpy as np

from acquisition.durable import write_durably
from acquisition.errors import BadRecordingError
from acquisition.recording.reader import Recording
from reconstruction.calibration.board_spec import parse_board
from reconstruction.calibration.boards import calibrate_board
from reconstruction.calibration.calibrated import Calibrated
from reconstruction.calibration.check import check_rig
from reconstruction.calibration.features import long_images
from reconstruction.calibration.moments import movers_of
from reconstruction.calibration.natural import calibrate_natural
from reconstruction.calibration.residual_picture import draw_residuals
from reconstruction.images.pixels import PixelCalibration, estimate_pixels, write_pixels
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.toml import dump_rig, load_rig
from server.cli.options import PATH, json_option
from server.cli.output import answer
from server.cli.progress import progress_of


@click.command("calibrate")
@click.argument("recording", metavar="REC", type=PATH)
@click.option("--pixels", nargs=2, type=PATH, metavar="FLAT_REC DARK_REC", help="Pixels, from even light and none.")
@click.option(
    "--board",
    metavar="SPEC",
    help="Lenses and poses, from a board that REC sees: charuco:COLSxROWS:SQUARE_MM:MARKER_MM:DICT or "
    "apriltag:COLSxROWS:TAG_MM:GAP_MM:36h11.",
)
@click.option("--natural", is_flag=True, help="Poses and focal length, from any textured scene that REC sees.")
@click.option("--out", type=PATH, required=True, help="RIG.toml to write; its other files go beside it.")
@json_option
def calibrate_command(
    recording: Path, pixels: tuple[Path, Path] | None, board: str | None, natural: bool, out: Path, as_json: bool
) -> None:
    """Measure the cameras that made REC: gain, offset, hot and dead pixels, or lenses and poses."""
    if (pixels is not None) + (board is not None) + natural != 1:
        raise click.UsageError("give one of --pixels, --board and --natural")
    if out.exists():
        raise BadRecordingError("exists already", "a new file", "choose another --out", where=out)
    if pixels is not None:
        return _calibrate_pixels(recording, pixels, out, as_json)
    spec = None if natural else parse_board(board or "")
    opened, today, progress = Recording.open(recording), datetime.date.today().isoformat(), progress_of("calibrate")
    if spec:
        found = calibrate_board(opened, spec, today, progress)
    else:
        images, movers = long_images(opened, opened.camera_ids), movers_of(opened, opened.camera_ids)
        found = calibrate_natural(opened.rig, images, today, progress=progress, movers=movers)
    picture = out.with_name(f"{out.stem}-residuals.png")
    _write_calibrated(found, out, picture)
    _print_calibrated(found, out, picture, as_json)


@click.command("check-rig")
@click.argument("recording", metavar="REC", type=PATH)
@click.option("--rig", type=PATH, help="RIG.toml to compare with.  [default: that of REC]")
@json_option
def check_rig_command(recording: Path, rig: Path | None, as_json: bool) -> None:
    """Find the cameras of REC anew from its scene, and compare them with its rig file; exit 1 if one has moved."""
    opened = Recording.open(recording)
    stored = load_rig(rig) if rig else opened.rig
    today = datetime.date.today().isoformat()
    images, movers = long_images(opened, opened.camera_ids), movers_of(opened, opened.camera_ids)
    found, checks = check_rig(stored, images, today, progress_of("check-rig"), movers=movers)
    moved = [check.camera for check in checks if not check.fits]
    other = "HAS MOVED" if stored.poses == "calibrated" else "stands elsewhere than drawn"
    lines = [
        f"{check.camera}: {'fits' if check.fits else other}: {check.turn_deg:.3f} degrees, "
        f"{1000 * check.shift_m:.2f} mm, focal {check.focal_percent:.2f} % off the rig file"
        for check in checks
    ]
    again = f"calibrate the rig: `spike4dgs calibrate {recording} --natural --out RIG.toml`"
    lines.append(f"found {', '.join(moved)} elsewhere; {again}" if moved else "the calibration still fits")
    rows = [dataclasses.asdict(check) for check in checks]
    document = {"fits": not moved, "moved": moved, "cameras": rows, "found": found.report}
    answer(document, "\n".join(lines), as_json=as_json)
    raise SystemExit(1 if moved else 0)


def _write_calibrated(found: Calibrated, out: Path, picture: Path) -> None:
    """Write the rig file `out`, and beside it its cameras' pixel maps and a picture of the residuals."""
    out.parent.mkdir(parents=True, exist_ok=True)
    draw_residuals(picture, found)
    maps = {}
    for camera in found.rig.cameras:
        if camera.pixels and camera.pixels.parent.resolve() != out.parent.resolve():
            maps[camera.id] = _pixel_map(out, camera.id)
            write_durably(maps[camera.id], camera.pixels.read_bytes())
    _write_rig(found.rig, maps, out)


def _calibrate_pixels(recording: Path, lights: tuple[Path, Path], out: Path, as_json: bool) -> None:
    """Measure the pixels of the cameras of `recording` from a flat and a dark one; write the rig file `out`."""
    rig = Recording.open(recording).rig
    flat, dark = map(Recording.open, lights)
    progress, found, rows, lines = progress_of("calibrate"), {}, {}, []
    for number, camera in enumerate(rig.cameras):
        progress(number / len(rig.cameras), camera.id)
        found[camera.id] = pixels = _estimate(camera, flat, dark)
        good, hot, dead = ~pixels.defect, int(pixels.hot.sum()), int(pixels.dead.sum())
        spread, offset = float(pixels.gain[good].std()), float(np.mean(pixels.offset[good]))
        rows[camera.id] = {"gain_spread": spread, "mean_offset": offset, "hot": hot, "dead": dead}
        means = f"gain spread {spread:.2%}, mean offset {offset:.5f} spikes per tick"
        lines.append(f"{camera.id}: {means}, {hot} hot, {dead} dead")
    out.parent.mkdir(parents=True, exist_ok=True)
    maps = {camera_id: _pixel_map(out, camera_id) for camera_id in found}
    for camera_id, path in maps.items():
        write_pixels(path, found[camera_id])
    _write_rig(rig, maps, out)
    progress(1.0, f"{len(found)} cameras")
    answer({"rig": str(out), "cameras": rows}, "\n".join(lines), as_json=as_json)


def _write_rig(rig: Rig, maps: Mapping[str, Path], out: Path) -> None:
    cameras = tuple(dataclasses.replace(c, pixels=maps.get(c.id, c.pixels)) for c in rig.cameras)
    write_durably(out, dump_rig(dataclasses.replace(rig, cameras=cameras)))


def _pixel_map(out: Path, camera_id: str) -> Path:
    return out.with_name(f"{out.stem}-{camera_id}-pixels.npz")


def _print_calibrated(found: Calibrated, out: Path, picture: Path, as_json: bool) -> None:
    rows: dict[str, dict[str, float]] = {}
    lines = [f"{out}: {found.report['summary']}"]
    for camera_id, sd in found.sd.items():
        off = found.residuals[camera_id][:, 2:]
        rms = float(np.sqrt((off**2).sum(axis=1).mean())) if len(off) else 0.0
        sds = {f"{name}_sd": value for name, value in dataclasses.asdict(sd).items()}
        rows[camera_id] = {"points": len(off), "residual_px": rms, **sds}
        turn, place = f"rotation +- {sd.rotation_deg:.4f} degrees", f"centre +- {1e3 * sd.center_m:.3f} mm"
        lines.append(f"{camera_id}: {len(off)} points, {turn}, {place}, focal length +- {sd.focal_percent:.3f} %")
    report = found.report | {"rig": str(out), "picture": str(picture), "cameras": rows}
    named = ("focal", "principal_point", "distortion", "metric_scale")
    lines += [f"{name.replace('_', ' ')}: {report[name]}" for name in named if name in report]
    lines.append(f"use it: `spike4dgs record --rig {out}`, `spike4dgs import --cameras {out}`")
    answer(report, "\n".join(lines), as_json=as_json)


def _estimate(camera: Camera, flat: Recording, dark: Recording) -> PixelCalibration:
    streams = []
    for recording in (flat, dark):
        with BadRecordingError.located(recording.path):
            streams.append(recording.stream(camera.id))
    layout = streams[0].layout
    if (layout.width, layout.height) != (camera.width, camera.height):
        found = f"{camera.id}: found {layout.width}x{layout.height} pixels"
        raise BadRecordingError(found, f"{camera.width}x{camera.height} as in REC", where=flat.path)
    with BadRecordingError.located(camera.id):
        return estimate_pixels(*streams)
