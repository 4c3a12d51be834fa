"""`python -m reconstruction.networks.training.msdi_train`: clips of several views, and MSDI trained on them.

Everything is resumed by giving the same command again; a killed training loses what came after its last score.
`clips` takes 2 s a clip, `network` 1 s a step on one core. Several GPUs: `torchrun --nproc-per-node N -m ... network`.
"""

import sys
from pathlib import Path

import click
import torch

from acquisition.progress import Progress
from reconstruction.networks.training import processes
from reconstruction.networks.training.msdi import TIERS, MsdiConfig, MsdiTraining
from reconstruction.networks.training.msdi_clips import MultiviewSet, write_clips
from reconstruction.networks.training.msdi_curve import plot_curves
from reconstruction.networks.training.msdi_validation import RANDOM, RANDOM_ERROR, random_views, recorded_views, scores
from rigs.errors import Spike4dgsError

FOLDER = click.Path(path_type=Path)
OUT = click.option("--out", type=FOLDER, required=True, help="Where what is made goes; a folder's work is resumed.")


@click.group()
def main() -> None:
    """Make clips of several views, and train the network that turns spikes into images, depth and poses."""


@main.command("clips")
@OUT
@click.option("--count", type=int, default=480, show_default=True, help="Clips; 2 MB each.")
@click.option("--first-seed", type=int, default=0, show_default=True, help="Seed of the first clip.")
@click.option("--views", type=int, default=4, show_default=True, help="Cameras a clip.")
def clips_command(out: Path, count: int, first_seed: int, views: int) -> None:
    """Render clips of random scenes seen by random rigs, and expose them."""
    write_clips(out, MultiviewSet(first_seed, count, views), _report("clips"))


@main.command("network")
@click.option("--clips", type=FOLDER, required=True, help="Folder of clips.")
@OUT
@click.option("--tier", "name", type=click.Choice(TIERS), default="small", show_default=True)
@click.option("--backbone", type=FOLDER, help="DUSt3R checkpoint the large tier starts from.")
@click.option("--development", type=FOLDER, multiple=True, help="Simulated recordings of fan_and_ball to score on.")
@click.option("--steps", type=int, default=6000, show_default=True, help="Steps altogether.")
@click.option("--joint/--separate", default=True, show_default=True, help="Whether geometry teaches the images, too.")
@click.option("--image-from", type=int, default=1500, show_default=True, help="Step from which the images learn.")
@click.option("--pose-from", type=int, default=600, show_default=True, help="Step from which poses are judged.")
@click.option("--score-every", type=int, default=500, show_default=True, help="Steps between scores.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the first weights and the samples.")
@click.option("--threads", type=int, default=0, help="Processor threads [default: as many as torch takes].")
@click.option("--device", type=click.Choice(["cpu", "cuda"]), default="cpu", show_default=True)
def network_command(
    clips: Path, out: Path, development: tuple[Path, ...], backbone: Path | None, threads: int, device: str, **settings
) -> None:
    """Train a tier on CLIPS."""
    torch.set_num_threads(threads or torch.get_num_threads())
    own = processes.start(device)
    try:
        config = MsdiConfig(**settings)
        report = _report(config.name)
        validation = {"random_seeds": list(RANDOM.seeds), "random_error": RANDOM_ERROR}
        notes = {"validation": validation | {"development": [folder.name for folder in development]}}
        training = MsdiTraining(out, config, clips, own, notes, backbone=backbone)
        scored = [*random_views(), *(recorded_views(folder) for folder in development)] if processes.first() else []
        training.run(lambda module: scores(module, scored), report)
    finally:
        processes.stop()


@main.command("curve")
@click.argument("trainings", type=FOLDER, nargs=-1, required=True)
@OUT
def curve_command(trainings: tuple[Path, ...], out: Path) -> None:
    """Draw the curves of TRAININGS, files training.json, as the picture --out."""
    plot_curves(trainings, out)


def _report(name: str) -> Progress:
    """Progress as a line on standard error at every new percent."""
    said = -1

    def report(fraction: float, message: str) -> None:
        nonlocal said
        if int(100 * fraction) > said:
            said = int(100 * fraction)
            click.echo(f"{name} {said:3d}% {message}", err=True)

    return report


if __name__ == "__main__":
    try:
        main()
    except Spike4dgsError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(error.exit_code)
