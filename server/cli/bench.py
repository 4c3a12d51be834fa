"""`bench`: measurements one can repeat, as one JSON document, a table and a plot."""

import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import click

from acquisition.bench_document import BenchDocument
from acquisition.devices.bench import parser_rows
from acquisition.durable import write_json
from acquisition.recording.bench import QUICK, Schedule, bench_recorder
from acquisition.scenes.catalog import DEVELOPMENT, DEVELOPMENT_SEEDS, EVALUATION, EVALUATION_SEEDS
from acquisition.scenes.digest import committed_digests, scenes_digest
from server.cli.progress import progress_of

TICKS = 400
_PARSED_BYTES = 10_000_000_000


@click.command("bench")
@click.argument(
    "name", type=click.Choice(["images", "leave-out", "pixels", "poses", "rasterizer", "recorder", "training"])
)
@click.option(
    "--scene", help="NAME,... [default: images, poses, training: the evaluation scenes; pixels: fan_and_ball]."
)
@click.option("--quick", is_flag=True, help="One seed, one budget, one scene and no sweeps; seconds of recording.")
@click.option(
    "--metric-files",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Folder of parameters for the images' metrics: alexnet*.pth (LPIPS), brisque_model_live.yml and "
    "brisque_range_live.yml (BRISQUE), niqe_pris_params.npz (NIQE).",
)
@click.option("--out", type=click.Path(path_type=Path), help="Folder for NAME.json and NAME.png; resumes there.")
@click.option("--json", "as_json", is_flag=True, help="Print the document as JSON.")
def bench_command(
    name: str, scene: str | None, quick: bool, metric_files: Path | None, out: Path | None, as_json: bool
) -> None:
    """Measure NAME.

    images, leave-out (plans against everything on), pixels (calibrated or not), poses (of the cameras), rasterizer,
    recorder (on the disk of --out), training.
    """
    with tempfile.TemporaryDirectory(dir=None if out or name != "recorder" else Path.cwd()) as spare:
        work = out / "work" if out else Path(spare)
        if name == "images":
            document = _images(scene, quick, work / name, metric_files)
        elif name == "rasterizer":
            from reconstruction.bench.rasterizer import bench_rasterizer

            document = bench_rasterizer()
        elif name == "pixels":
            from reconstruction.bench.pixels import bench_pixels

            document = bench_pixels(scene or "fan_and_ball", EVALUATION_SEEDS[:1] if quick else EVALUATION_SEEDS)
        elif name == "leave-out":
            document = _leave_out(quick, work / name)
        elif name == "poses":
            document = _poses(scene, quick, work)
        elif name == "recorder":
            document = _recorder(work / name, quick)
        else:
            document = _training(scene, quick, work)
        document.scenes = scenes_digest(committed_digests())
        found = document.to_json()
        if out:
            _write(out, name, found, work)
    click.echo(json.dumps(found) if as_json else _table(found))


def _recorder(folder: Path, quick: bool) -> BenchDocument:
    """The rings and writers on the disk, and the parser that feeds them."""
    document = bench_recorder(folder, QUICK if quick else Schedule(), progress_of("recorder"))
    rows, summary = parser_rows(_PARSED_BYTES // 10 if quick else _PARSED_BYTES, document.summary["memcpy_gb_s"])
    document.rows += rows
    document.summary |= summary
    return document


def _write(out: Path, name: str, found: dict, work: Path) -> None:
    """The document of a bench in `out`, and what it can be seen by."""
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / f"{name}.json", found)
    if name == "training":
        from reconstruction.bench.contact_sheet import write_run_strip, write_sheet
        from reconstruction.bench.plot import plot_training

        plot_training(out / f"{name}.png", found)
        longest = max(r["budget_s"] for r in found["rows"] if r["method"] == "auto")
        for run in sorted(work.glob(f"*-auto-{longest:g}s")):
            write_run_strip(work / "strips" / f"{run.name}.png", run)
        write_sheet(out / f"{name}-sheet.png", work / "strips", most_px=1200)
    elif name == "poses":
        from reconstruction.bench.plot_poses import plot_poses

        plot_poses(out / f"{name}.png", found)
    elif name == "leave-out":
        from reconstruction.bench.plot_leave_out import plot_leave_out

        plot_leave_out(out / "leave_out.png", found)
    elif name == "images":
        from reconstruction.bench.contact_sheet import write_sheet
        from reconstruction.bench.plot_images import plot_images

        plot_images(out / f"{name}.png", found)
        write_sheet(out / f"{name}-sheet.png", work / name)


def _images(scenes: str | None, quick: bool, work: Path, metric_files: Path | None) -> BenchDocument:
    from reconstruction.bench.images import Extent, ImageBench  # a capture host has none of these

    names = tuple(scenes.split(",")) if scenes else EVALUATION
    extent = Extent(names[:1], EVALUATION_SEEDS[:1], sweeps=False) if quick else Extent(names, EVALUATION_SEEDS)
    return ImageBench(extent, work, metric_files).run(progress_of("images"))


def _training(scenes: str | None, quick: bool, work: Path) -> BenchDocument:
    from reconstruction.bench.training import Clip, bench_training
    from reconstruction.bench.variants import AUTO, VARIANTS

    named = tuple(scenes.split(",")) if scenes else (*EVALUATION, *DEVELOPMENT)
    variants = list(VARIANTS[:1] if quick else VARIANTS)
    if scenes:  # a scene that is asked for is run by the whole engine, whichever kind it is
        variants = [replace(v, scenes=named) if v is AUTO else v for v in variants]
    if quick:
        named, variants = named[:1], [replace(v, budgets_s=v.budgets_s[1:2]) for v in variants]
    clips = [Clip(scene, seed, path) for scene, seed, path in _recorded(named, work)]
    document = bench_training(clips, variants, work, progress_of)
    document.omissions.append("one seed a scene")
    return document


def _poses(scenes: str | None, quick: bool, work: Path) -> BenchDocument:
    from reconstruction.bench.pose_methods import BOARD_SCENE, BOARD_TICKS
    from reconstruction.bench.poses import PoseClip, bench_poses

    named = tuple(scenes.split(",")) if scenes else EVALUATION
    clips = [PoseClip(*found) for found in _recorded(named[:1] if quick else named, work)]
    boards = [] if quick else [PoseClip(*found) for found in _recorded((BOARD_SCENE,), work, BOARD_TICKS)]
    return bench_poses(clips, boards[0] if boards else None, work / "poses", progress_of("poses"), quick=quick)


def _leave_out(quick: bool, work: Path) -> BenchDocument:
    from reconstruction.bench.leave_out import bench_leave_out

    return bench_leave_out(work, progress_of("leave-out"), quick=quick)


def _recorded(scenes: tuple[str, ...], work: Path, ticks: int = TICKS) -> list[tuple[str, int, Path]]:
    """A recording of each scene in `work`, simulated where there is none: scene, seed, folder."""
    found = []
    for scene in scenes:
        seed = DEVELOPMENT_SEEDS[1] if scene in DEVELOPMENT else EVALUATION_SEEDS[0]
        recording = work / f"{scene}-{seed}"
        if not recording.exists():
            recording.parent.mkdir(parents=True, exist_ok=True)
            _simulate_apart(scene, seed, ticks, recording)
        found.append((scene, seed, recording))
    return found


def _simulate_apart(scene: str, seed: int, ticks: int, recording: Path) -> None:
    """`simulate` in a process of its own, whose threads wait as many pools should."""
    options = {"scene": scene, "seed": seed, "ticks": ticks, "out": recording}
    command = [sys.executable, "-m", "server.cli", "simulate"]
    subprocess.run(command + [word for k, v in options.items() for word in (f"--{k}", str(v))], check=True)


def _table(document: dict) -> str:
    width = max(len(key) for key in document["summary"])
    lines = [f"{key:{width}}  {value:.6g}" for key, value in document["summary"].items()]
    return "\n".join([*lines, *(f"left out: {o}" for o in document["omissions"])])
