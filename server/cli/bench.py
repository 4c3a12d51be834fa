"""`bench`: measurements one can repeat, as one JSON document, a table and a plot."""

import json
import tempfile
from pathlib import Path

import click

from acquisition.bench_document import BenchDocument
from acquisition.devices.open import Simulation
from acquisition.durable import write_json
from acquisition.recording.bench import QUICK, Schedule, bench_recorder
from acquisition.session.record import simulate
from rigs.toml import catalog_rig
from server.cli.progress import progress_of

EVALUATION_SEEDS = (101, 102, 103)  # development used seeds 1 to 9
TICKS = 400


@click.command("bench")
@click.argument("name", type=click.Choice(["images", "rasterizer", "recorder", "training"]))
@click.option("--scene", default="fan_and_ball", show_default=True, help="Scene the bench runs on.")
@click.option("--quick", is_flag=True, help="One seed and one budget; seconds of recording.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for NAME.json and NAME.png; resumes there.")
@click.option("--json", "as_json", is_flag=True, help="Print the document as JSON.")
def bench_command(name: str, scene: str, quick: bool, out: Path | None, as_json: bool) -> None:
    """Measure NAME: images, rasterizer, recorder (the disk of --out, or of this folder) or training."""
    with tempfile.TemporaryDirectory(dir=None if out or name != "recorder" else Path.cwd()) as spare:
        work = out / "work" if out else Path(spare)
        if name == "images":
            from reconstruction.bench.images import bench_images  # a capture host has none of these

            document = bench_images(scene, EVALUATION_SEEDS[0])
        elif name == "rasterizer":
            from reconstruction.bench.rasterizer import bench_rasterizer

            document = bench_rasterizer()
        elif name == "recorder":
            document = bench_recorder(work / name, QUICK if quick else Schedule(), progress_of(name))
        else:
            document = _training(scene, quick, work)
    found = document.to_json()
    if out:
        out.mkdir(parents=True, exist_ok=True)
        write_json(out / f"{name}.json", found)
        if name == "training":
            from reconstruction.bench.plot import plot_training

            plot_training(out / f"{name}.png", found)
    click.echo(json.dumps(found) if as_json else _table(found))


def _training(scene: str, quick: bool, work: Path) -> BenchDocument:
    from reconstruction.bench.training import BUDGETS_S, bench_training

    seeds, budgets = (EVALUATION_SEEDS[:1], BUDGETS_S[1:2]) if quick else (EVALUATION_SEEDS, BUDGETS_S)
    recordings = []
    for seed in seeds:
        recording = work / f"{scene}-{seed}"
        if not recording.exists():
            recording.parent.mkdir(parents=True, exist_ok=True)
            simulate(Simulation(scene, seed), catalog_rig("lab3x3"), TICKS, recording, progress_of("simulate"))
        recordings.append((scene, seed, recording))
    return bench_training(recordings, budgets, work, progress_of)


def _table(document: dict) -> str:
    width = max(len(key) for key in document["summary"])
    lines = [f"{key:{width}}  {value:.6g}" for key, value in document["summary"].items()]
    return "\n".join([*lines, *(f"left out: {o}" for o in document["omissions"])])
