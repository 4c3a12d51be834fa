"""`export`: a run in the formats of other tools."""

from pathlib import Path
from typing import Any

import click

from reconstruction.export.catalogue import FORMATS, check_target, checked_format, export_scene
from reconstruction.export.scene import Choices
from reconstruction.pipeline.trained_scene import trained_scene
from server.cli.options import PATH, from_tick, to_tick
from server.cli.progress import progress_of
from server.cli.runs import trained_run


@click.command("export")
@click.argument("run_folder", metavar="RUN", type=PATH)
@click.option("--format", "name", required=True, help=f"One of: {', '.join(FORMATS)}.")
@click.option("--out", type=PATH, required=True, help="The file, or the folder of a format that has several.")
@click.option(
    "--at", "at_s", metavar="SECONDS", type=float, help="Instant on the rig clock [default: the clip's middle]."
)
@click.option("--frames", type=int, help="How many, for a format over time [default: 30; an orbit's 120].")
@click.option("--camera", help="For video and depth [default: video orbits; depth is the held-out or centre camera's].")
@from_tick
@to_tick
@click.option("--overwrite", is_flag=True, help="Replace a file, or a folder that an export made.")
def export_command(run_folder: Path, name: str, out: Path, overwrite: bool, **chosen: Any) -> None:
    """Write RUN for other tools.

    Splats (ply, splat, spz, glb) at one instant, ply-sequence over the clip; a video; depth maps; datasets (colmap,
    nerfstudio) with cameras, images and points; viewer, the scene that the browser's viewer plays. What goes over time
    can be cut to the ticks from A to B of the rig clock.
    """
    choices = Choices(**chosen)
    check_target(out, folder=checked_format(name, choices).folder, overwrite=overwrite)
    scene = trained_scene(trained_run(run_folder))
    export_scene(scene, name, out, choices, overwrite=overwrite, progress=progress_of("export"))
    click.echo(f"{name} of {run_folder} in {out}")
