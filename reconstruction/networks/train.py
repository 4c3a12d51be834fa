"""`python -m reconstruction.networks.train`: random scenes to train on, and the networks that learn from them.

Everything is resumed by giving the same command again; a killed training loses what came after its last score. `clips`
takes 1 s a clip, `view-clips` 1 to 2 s, up to a minute where a path tracer draws it. `network small` takes 1 to 2 hours
on two cores; `network published --device cuda --batch 16` wants a GPU. `own REC` trains the blind-spot network on a
recording of one's own, whose true light nobody knows. `msdi` takes 1 s a step on one core; on several cores or GPUs:
`torchrun --nproc-per-node N -m ... msdi`. With `--after` it goes on from weights that were trained elsewhere, by other
samples if the seed is another.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import click
import torch

from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.networks.image_networks import IMAGE_NETWORKS, image_network, infer, loss
from reconstruction.networks.msdi.network import small_msdi
from reconstruction.networks.training import msdi_validation, processes
from reconstruction.networks.training.clips import VIEW_KINDS, CameraClips, MultiviewClips, read_clip_set, write_clips
from reconstruction.networks.training.curve import plot_curves
from reconstruction.networks.training.image_training import (
    Batches,
    ClipPictures,
    ImageTraining,
    ImageTrainingConfig,
    StreamPictures,
)
from reconstruction.networks.training.image_validation import scores, validation_clips, validation_set
from reconstruction.networks.training.msdi_training import TIERS, MsdiConfig, MsdiTraining
from reconstruction.tensors import read_weights
from rigs.errors import Spike4dgsError

FOLDER = click.Path(path_type=Path)
OUT = click.option("--out", type=FOLDER, required=True, help="Where what is made goes; a folder's work is resumed.")
CLIPS = click.option("--clips", "folder", type=FOLDER, required=True, help="Folder of clips.")
CROP = click.option("--crop", type=int, default=64, show_default=True, help="Pixels a side of a crop.")
SEED = click.option("--seed", type=int, default=0, show_default=True, help="Of the first weights and the batches.")
FIRST_SEED = click.option("--first-seed", type=int, default=0, show_default=True, help="Seed of the first clip.")
KINDS = click.option(
    "--kind",
    "kinds",
    type=click.Choice(VIEW_KINDS),
    multiple=True,
    default=VIEW_KINDS,
    help="Scenes, in turns [default: all; all but clutter need the extra `realistic`].",
)
DEVELOPMENT = click.option(
    "--development", type=FOLDER, multiple=True, help="Simulated recordings of development scenes to score on."
)
THREADS = click.option("--threads", type=int, default=0, help="Processor threads [default: as many as torch takes].")
DEVICE = click.option("--device", type=click.Choice(["cpu", "cuda"]), default="cpu", show_default=True)
SELF_TAUGHT = "blindspot"
Command = TypeVar("Command", bound=Callable[..., object])


def _steps(steps: int, score_every: int) -> Callable[[Command], Command]:
    """Return the options of a training's length, with these defaults."""
    length = click.option("--steps", type=int, default=steps, show_default=True, help="Steps altogether.")
    scored = click.option("--score-every", default=score_every, show_default=True, help="Steps between scores.")
    return lambda command: length(scored(command))


@click.group()
def main() -> None:
    """Make training clips, train the networks, and draw how they learnt."""


@main.command("clips")
@OUT
@click.option("--count", type=int, default=700, show_default=True, help="Clips; 0.3 MB each.")
@FIRST_SEED
@click.option("--size", type=int, default=96, show_default=True, help="Pixels a side.")
def clips_command(out: Path, count: int, first_seed: int, size: int) -> None:
    """Render clips of random scenes seen by one camera, and expose them."""
    write_clips(out, CameraClips(first_seed, count, size), _report("clips"))


@main.command("view-clips")
@OUT
@click.option("--count", type=int, default=480, show_default=True, help="Clips; 2 MB each.")
@FIRST_SEED
@click.option("--views", type=int, default=4, show_default=True, help="Cameras a clip.")
@KINDS
def view_clips_command(out: Path, count: int, first_seed: int, views: int, kinds: tuple[str, ...]) -> None:
    """Render clips of random scenes seen by random rigs, and expose them."""
    write_clips(out, MultiviewClips(first_seed, count, views, kinds=kinds), _report("clips"))


@main.command("network")
@click.argument("name", type=click.Choice(list(IMAGE_NETWORKS)))
@CLIPS
@OUT
@_steps(12000, 500)
@click.option("--batch", type=int, default=8, show_default=True, help="Crops a step.")
@CROP
@SEED
@THREADS
@DEVICE
def network_command(folder: Path, out: Path, threads: int, device: str, **settings) -> None:
    """Train the image network NAME on clips."""
    torch.set_num_threads(threads or torch.get_num_threads())
    config = ImageTrainingConfig(**settings)
    network = image_network(config.name)
    training = ImageTraining(out, config, ClipPictures(folder, network), device, validation=validation_set())
    clips = validation_clips(_report("validation"))
    training.run(lambda module: scores(lambda *at: infer(network, module, *at)[0], clips), _report(config.name))


@main.command("own")
@click.argument("recording", type=FOLDER)
@OUT
@_steps(3000, 250)
@CROP
@SEED
def own_command(recording: Path, out: Path, **settings) -> None:
    """Train the blind-spot network on RECORDING, all its cameras, without any truth.

    Its curve is the loss at instants it does not train on. `images --method blindspot --weights OUT/blindspot.npz`
    then uses it.
    """
    opened, network = Recording.open(recording), image_network(SELF_TAUGHT)
    streams = [opened.stream(camera) for camera in opened.camera_ids]
    config = ImageTrainingConfig(SELF_TAUGHT, **settings)
    training = ImageTraining(out, config, StreamPictures(streams, network, config.seed), "cpu")
    others = StreamPictures(streams, network, config.seed + 1)
    unseen = Batches(others, network, 4 * config.batch, config.crop, config.seed).batch(0)

    def score(module: torch.nn.Module) -> dict[str, float]:
        with torch.no_grad():
            return {"unseen_loss": loss(network, module.train(), *unseen).item()}

    training.run(score, _report(SELF_TAUGHT))


@main.command("msdi")
@CLIPS
@OUT
@click.option("--tier", "name", type=click.Choice(TIERS), default="small", show_default=True)
@click.option("--backbone", type=FOLDER, help="DUSt3R checkpoint the large tier starts from.")
@click.option("--after", type=FOLDER, help="Document of an earlier training; its weights beside it are the first.")
@DEVELOPMENT
@_steps(6000, 500)
@click.option("--joint/--separate", default=True, show_default=True, help="Whether geometry teaches the images, too.")
@click.option("--pretrained/--from-scratch", default=True, show_default=True, help="The image network.")
@click.option("--image-from", type=int, default=1500, show_default=True, help="Step from which the images learn.")
@click.option("--pose-from", type=int, default=600, show_default=True, help="Step from which poses are judged.")
@SEED
@THREADS
@DEVICE
def msdi_command(
    folder: Path,
    out: Path,
    development: tuple[Path, ...],
    backbone: Path | None,
    after: Path | None,
    threads: int,
    device: str,
    **settings,
) -> None:
    """Train a tier of MSDI on clips of several views."""
    torch.set_num_threads(threads or torch.get_num_threads())
    own = processes.start(device)
    try:
        config = MsdiConfig(**settings)
        random = msdi_validation.random_clips(read_clip_set(folder, MultiviewClips).kinds)
        notes = {"validation": msdi_validation.validation_set(random, development)}
        training = MsdiTraining(out, config, folder, own, notes, backbone=backbone, after=after)
        scored = msdi_validation.scored_views(random, development, _report("validation")) if processes.first() else []
        training.run(lambda module: msdi_validation.scores(module, scored), _report(config.name))
    finally:
        processes.stop()


@main.command("msdi-scores")
@click.argument("weights", type=FOLDER, nargs=-1, required=True)
@KINDS
@click.option("--count", default=msdi_validation.CLIPS, show_default=True, help="Random clips.")
@DEVELOPMENT
def msdi_scores_command(weights: tuple[Path, ...], kinds: tuple[str, ...], count: int, development: tuple[Path, ...]):
    """Score WEIGHTS of the small MSDI on random clips that no training sees, and on recordings: a JSON line each."""
    random = msdi_validation.random_clips(kinds, count)
    scored = msdi_validation.scored_views(random, development, _report("validation"))
    for path in weights:
        network = small_msdi().eval()
        read_weights(path, network)
        for scene, found in msdi_validation.scores_by_scene(network, scored).items():
            click.echo(json.dumps({"scene": scene, "weights": str(path)} | found))


@main.command("curve")
@click.argument("trainings", type=FOLDER, nargs=-1, required=True)
@OUT
def curve_command(trainings: tuple[Path, ...], out: Path) -> None:
    """Draw the curves of TRAININGS, files training.json, as the picture --out."""
    plot_curves(trainings, out)


def _report(name: str) -> Progress:
    """Return a progress that writes a line to standard error at every new percent."""
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
