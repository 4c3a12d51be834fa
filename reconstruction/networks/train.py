"""`python -m reconstruction.networks.train`: clips of random scenes, and networks trained on them.

Everything is resumed by giving the same command again; a killed training loses what came after its last score.
`clips` takes 1 s a clip. `network small` takes 1 to 2 hours on two cores, `network published --device cuda --batch 16`
wants a GPU. `own REC` trains the blind-spot network on a recording of one's own, whose true light nobody knows.
"""

import sys
from pathlib import Path

import click
import torch

from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.networks.image_inference import infer
from reconstruction.networks.image_networks import IMAGE_NETWORKS, image_network, loss
from reconstruction.networks.training.curve import plot_curves
from reconstruction.networks.training.image_batches import Batches, ClipPictures, StreamPictures
from reconstruction.networks.training.image_clips import ClipSet, write_clips
from reconstruction.networks.training.image_validation import scores, validation_clips, validation_set
from reconstruction.networks.training.loop import Training, TrainingConfig
from rigs.errors import Spike4dgsError

FOLDER = click.Path(path_type=Path)
OUT = click.option("--out", type=FOLDER, required=True, help="Where what is made goes; a folder's work is resumed.")
SELF_TAUGHT = "blindspot"


@click.group()
def main() -> None:
    """Make training clips, and train the networks that turn spikes into images."""


@main.command("clips")
@OUT
@click.option("--count", type=int, default=700, show_default=True, help="Clips; 0.3 MB each.")
@click.option("--first-seed", type=int, default=0, show_default=True, help="Seed of the first clip.")
@click.option("--size", type=int, default=96, show_default=True, help="Pixels a side.")
def clips_command(out: Path, count: int, first_seed: int, size: int) -> None:
    """Render clips of random scenes and expose them."""
    write_clips(out, ClipSet(first_seed, count, size), _report("clips"))


@main.command("network")
@click.argument("name", type=click.Choice(list(IMAGE_NETWORKS)))
@click.option("--clips", "folder", type=FOLDER, required=True, help="Folder of clips.")
@OUT
@click.option("--steps", type=int, default=12000, show_default=True, help="Steps altogether.")
@click.option("--batch", type=int, default=8, show_default=True, help="Crops a step.")
@click.option("--crop", type=int, default=64, show_default=True, help="Pixels a side of a crop.")
@click.option("--score-every", type=int, default=500, show_default=True, help="Steps between scores.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the first weights and the batches.")
@click.option("--threads", type=int, default=0, help="Processor threads [default: as many as torch takes].")
@click.option("--device", type=click.Choice(["cpu", "cuda"]), default="cpu", show_default=True)
def network_command(folder: Path, out: Path, threads: int, device: str, **settings) -> None:
    """Train the network NAME on clips."""
    torch.set_num_threads(threads or torch.get_num_threads())
    config = TrainingConfig(**settings)
    network = image_network(config.name)
    notes = {"validation": validation_set()}
    training = Training(out, config, ClipPictures(folder, network), device, notes)
    clips = validation_clips(_report("validation"))
    training.run(lambda module: scores(lambda *at: infer(network, module, *at)[0], clips), _report(config.name))


@main.command("own")
@click.argument("recording", type=FOLDER)
@OUT
@click.option("--steps", type=int, default=3000, show_default=True, help="Steps altogether.")
@click.option("--crop", type=int, default=64, show_default=True, help="Pixels a side of a crop.")
@click.option("--score-every", type=int, default=250, show_default=True, help="Steps between scores.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the first weights and the batches.")
def own_command(recording: Path, out: Path, **settings) -> None:
    """Train the blind-spot network on RECORDING, all its cameras, without any truth.

    Its curve is the loss at instants it does not train on. `images --method blindspot --weights OUT/blindspot.npz`
    then uses it.
    """
    opened, network = Recording.open(recording), image_network(SELF_TAUGHT)
    streams = [opened.stream(camera) for camera in opened.camera_ids]
    config = TrainingConfig(SELF_TAUGHT, **settings)
    training = Training(out, config, StreamPictures(streams, network, config.seed), "cpu")
    others = StreamPictures(streams, network, config.seed + 1)
    unseen = Batches(others, network, 4 * config.batch, config.crop, config.seed).batch(0)

    def score(module: torch.nn.Module) -> dict[str, float]:
        with torch.no_grad():
            return {"unseen_loss": loss(network, module.train(), *unseen).item()}

    training.run(score, _report(SELF_TAUGHT))


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
