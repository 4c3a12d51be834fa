"""`calibrate`: measure a rig's cameras, their pixels or where they stand, and write what was found into a rig file."""

import dataclasses
import datetime
import json
from pathlib import Path

import click
import numpy as np

from acquisition.durable import write_durably
from acquisition.errors import BadRecordingError
from acquisition.recording.reader import Recording
from reconstruction.calibration.board_spec import parse_board
from reconstruction.calibration.boards import calibrate_board
from reconstruction.calibration.calibrated import Calibrated
from reconstruction.calibration.features import long_image
from reconstruction.calibration.natural import calibrate_natural
from reconstruction.calibration.residual_picture import draw_residuals
from rigs.rig import Rig
from rigs.toml import dump_rig
from server.cli.calibrate_pixels import calibrate_pixels
from server.cli.progress import progress_of

FOLDER = click.Path(path_type=Path)


@click.command("calibrate")
@click.argument("recording", metavar="REC", type=FOLDER)
@click.option("--pixels", nargs=2, type=FOLDER, metavar="FLAT_REC DARK_REC", help="Pixels, from even light and none.")
@click.option(
    "--board",
    metavar="SPEC",
    help="Lenses and poses, from a board that REC sees: charuco:COLSxROWS:SQUARE_MM:MARKER_MM:DICT or "
    "apriltag:COLSxROWS:TAG_MM:GAP_MM:36h11.",
)
@click.option("--natural", is_flag=True, help="Poses and focal length, from the scene that REC sees, whatever it is.")
@click.option("--out", type=FOLDER, required=True, help="RIG.toml to write; what belongs to it goes beside it.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def calibrate_command(
    recording: Path, pixels: tuple[Path, Path] | None, board: str | None, natural: bool, out: Path, as_json: bool
) -> None:
    """Measure the cameras that made REC: gain, offset, hot and dead pixels, or lenses and poses."""
    if (pixels is not None) + (board is not None) + natural != 1:
        raise click.UsageError("give one of --pixels, --board and --natural")
    if out.exists():
        raise BadRecordingError("exists already", "a new file", "choose another --out", where=out)
    if pixels is not None:
        calibrate_pixels(recording, pixels, out, as_json=as_json)
        return
    spec = None if natural else parse_board(board or "")
    opened, date, progress = Recording.open(recording), datetime.date.today().isoformat(), progress_of("calibrate")
    if spec:
        found = calibrate_board(opened, spec, date, progress)
    else:
        images = {camera: long_image(opened.stream(camera)) for camera in opened.camera_ids}
        found = calibrate_natural(opened.rig, images, date, progress=progress)
    write_calibrated(found, out)
    _print_calibrated(found, out, as_json)


def write_calibrated(found: Calibrated, out: Path) -> None:
    """Write the rig file `out`, its cameras' pixel maps beside it, and a picture of the residuals."""
    out.parent.mkdir(parents=True, exist_ok=True)
    draw_residuals(_picture(out), found)
    write_durably(out, dump_rig(_with_pixels_beside(found.rig, out)))


def _with_pixels_beside(rig: Rig, out: Path) -> Rig:
    cameras = []
    for camera in rig.cameras:
        if camera.pixels and camera.pixels.parent.resolve() != out.parent.resolve():
            beside = out.with_name(f"{out.stem}-{camera.id}-pixels.npz")
            write_durably(beside, camera.pixels.read_bytes())
            camera = dataclasses.replace(camera, pixels=beside)
        cameras.append(camera)
    return dataclasses.replace(rig, cameras=tuple(cameras))


def _picture(out: Path) -> Path:
    return out.with_name(f"{out.stem}-residuals.png")


def _by_camera(found: Calibrated) -> dict[str, dict[str, float]]:
    """What is left over in each camera, and one standard deviation of what was found about it."""
    rows = {}
    for camera_id, sd in found.sd.items():
        off = found.residuals[camera_id][:, 2:]
        rms = float(np.sqrt((off**2).sum(axis=1).mean())) if len(off) else 0.0
        sds = {f"{name}_sd": value for name, value in dataclasses.asdict(sd).items()}
        rows[camera_id] = {"points": len(off), "residual_px": rms, **sds}
    return rows


def _print_calibrated(found: Calibrated, out: Path, as_json: bool) -> None:
    report = found.report | {"rig": str(out), "picture": str(_picture(out)), "cameras": _by_camera(found)}
    if as_json:
        click.echo(json.dumps(report))
        return
    click.echo(f"{out}: {report['summary']}")
    for camera_id, sd in found.sd.items():
        rows = found.residuals[camera_id]
        click.echo(
            f"{camera_id}: {len(rows)} points, rotation +- {sd.rotation_deg:.4f} degrees, centre +- "
            f"{1e3 * sd.center_m:.3f} mm, focal length +- {sd.focal_percent:.3f} %"
        )
    for name in ("focal", "principal_point", "distortion", "metric_scale"):
        if name in report:
            click.echo(f"{name.replace('_', ' ')}: {report[name]}")
