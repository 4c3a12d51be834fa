"""`check-rig`: does the stored calibration still fit this recording?"""

import dataclasses
import datetime
import json
from pathlib import Path

import click

from acquisition.recording.reader import Recording
from rigs.toml import load_rig
from server.cli.progress import progress_of


@click.command("check-rig")
@click.argument("recording", metavar="REC", type=click.Path(path_type=Path))
@click.option("--rig", type=click.Path(path_type=Path), help="RIG.toml to compare with.  [default: that of REC]")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
@click.pass_context
def check_rig_command(context: click.Context, recording: Path, rig: Path | None, as_json: bool) -> None:
    """Find the cameras of REC anew from its scene, and compare them with its rig file; exit 1 where one has moved."""
    from reconstruction.calibration.check import check_rig
    from reconstruction.calibration.features import long_image

    opened = Recording.open(recording)
    stored = load_rig(rig) if rig else opened.rig
    images = {camera: long_image(opened.stream(camera)) for camera in opened.camera_ids}
    today, checks = check_rig(stored, images, datetime.date.today().isoformat(), progress_of("check-rig"))
    moved = [check.camera for check in checks if not check.fits]
    if as_json:
        rows = [dataclasses.asdict(check) for check in checks]
        click.echo(json.dumps({"fits": not moved, "moved": moved, "cameras": rows, "found": today.report}))
    else:
        for check in checks:
            click.echo(
                f"{check.camera}: {'fits' if check.fits else 'HAS MOVED'}: {check.turn_deg:.3f} degrees, "
                f"{1000 * check.shift_m:.2f} mm, focal {check.focal_percent:.2f} % off the rig file"
            )
        said = f"found {', '.join(moved)} moved; calibrate the rig again" if moved else "the calibration still fits"
        click.echo(said)
    context.exit(1 if moved else 0)
