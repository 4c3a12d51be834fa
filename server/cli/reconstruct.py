"""`reconstruct`, `render` and `evaluate`: from a recording to Gaussians to pictures."""

import json
import signal
import threading
import time
from pathlib import Path

import click

from acquisition.arrays import write_array
from reconstruction.errors import BadRunError
from reconstruction.pipeline.stages import reconstruct, reconstruct_part
from reconstruction.rendering.limits import frames_to_render
from reconstruction.run.configuration import CHOICES, DEFAULT_BUDGET_S, FOLLOW, STAGES, ReconstructionConfig
from reconstruction.run.parts import STILL, span_name
from reconstruction.truth import Truth
from server.cli.options import PATH, from_tick, json_option, several, to_tick
from server.cli.output import answer, scores
from server.cli.progress import progress_of, warn
from server.cli.runs import trained_run

_MORE = {  # of the help of a choice
    "init": "; auto is natural for a nominal rig",
    "points": "; found are those of the initialiser, random ones only show what points are worth",
    "supervision": "; both compares images and counts",
    "pixels": "; maps are those of calibrate --pixels",
    "gains": "; a gain and a lag of each camera, where the recording tells them",
    "refine": "; learn poses, gains and lags beside the Gaussians",
    "device": "; where the training is done. auto is cpu, since cuda, which is by gsplat, never ran",
}
_choices = (
    click.option(f"--{name}", default="auto", help=f"One of: {', '.join(names)}{_MORE.get(name, '')}.")
    for name, names in CHOICES.items()
)


@click.command("reconstruct")
@click.argument("recording", metavar="REC", type=PATH)
@click.option("--out", type=PATH, required=True, help="Run folder; an unfinished one is resumed.")
@several(*_choices)
@click.option("--dust3r-checkpoint", metavar="FILE", help="Your DUSt3R weights, for --init dust3r; none are shipped.")
@click.option("--holdout", help="Camera to score on; never read before the report.")
@click.option("--views", default="", help="Training cameras, comma-separated [default: all but the held-out one].")
@click.option("--tick-stride", type=int, default=4, show_default=True, help="Planes between instants used as images.")
@click.option("--window", type=int, metavar="PLANES", help="Planes of an image of movers [default: by the plan].")
@click.option(
    "--span", type=int, metavar="PLANES", help="Most planes of a span of a long recording [default: by the plan]."
)
@from_tick
@to_tick
@click.option("--budget-s", type=float, help=f"Wall seconds to the final checkpoint [default: {DEFAULT_BUDGET_S:g}].")
@click.option("--steps", type=int, help="Training steps instead of a budget; repeatable to the bit.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("--stage", type=click.Choice((FOLLOW, *STAGES)), help="Run only this stage.")
@click.option(
    "--again", type=int, metavar="N", help="With --stage: forget it and the later ones first; N grows with each repeat."
)
@click.option(
    "--part",
    metavar="still|NUMBER",
    help="With --stage train: learn this part of a long recording alone; its seconds are a share of --budget-s.",
)
@click.option("--follow", "follows", is_flag=True, help="REC is still recorded: show looks at it until it is whole.")
@json_option
@click.pass_obj
def reconstruct_command(
    started: float,
    recording: Path,
    out: Path,
    views: str,
    budget_s: float | None,
    steps: int | None,
    stage: str | None,
    again: int | None,
    part: str | None,
    follows: bool,
    as_json: bool,
    **choices: str,
) -> None:
    """Reconstruct REC into a run folder."""
    if budget_s is None and steps is None:
        budget_s = DEFAULT_BUDGET_S
    named = tuple(v.strip() for v in views.split(",") if v.strip())
    config = ReconstructionConfig(views=named, budget_s=budget_s, steps=steps, **choices)  # type: ignore[arg-type]
    if again is not None and stage is None:
        raise click.UsageError("found --again without --stage, expected the stage to begin with")
    stop = threading.Event()  # training then saves a checkpoint and ends
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    if follows and stage is not None:
        raise click.UsageError(f"found --follow with --stage, expected `--stage {FOLLOW}` for the looks alone")
    if part is not None:
        name = _part_name(part, stage)
        own = progress_of("train")
        if not reconstruct_part(recording, out, config, name, own, again=again, should_stop=stop.is_set):
            click.echo(f"part {name}: it was there already; what this process has learnt is dropped", err=True)
        return
    if follows or stage == FOLLOW:
        from reconstruction.pipeline.follow import follow

        follow(recording, out, config, progress_of("follow"), stop.is_set)
        started = time.monotonic()
    if stage == FOLLOW:
        return
    run = reconstruct(
        recording, out, config, progress_of, stage=stage, again=again, started=started, should_stop=stop.is_set
    )
    for text in run.document.warnings.values():
        warn(text)
    if run.has("report"):
        metrics = json.loads((run.path / "metrics.json").read_text())
        answer(metrics, f"{scores(metrics)}\nreport: {run.path / 'report.html'}", as_json=as_json)


def _part_name(text: str, stage: str | None) -> str:
    """Return the name of the part that `text` is; raises click.UsageError."""
    if stage != "train":
        raise click.UsageError("found --part without --stage train, expected both")
    if text == STILL:
        return text
    if not text.isdecimal():
        raise click.UsageError(f"found --part {text[:20]!r}, expected {STILL} or the number of a span")
    return span_name(int(text))


@click.command("render")
@click.argument("run_folder", metavar="RUN", type=PATH)
@click.option("--cameras", type=PATH, required=True, help="transforms.json; each frame has a time in seconds.")
@click.option(
    "--out", type=PATH, required=True, help="Folder for NNNNNN.npy, NNNNNN.png, depth_NNNNNN.npy and sd_NNNNNN.npy."
)
def render_command(run_folder: Path, cameras: Path, out: Path) -> None:
    """Render RUN from any cameras at any time, with depth and the error to expect."""
    from reconstruction.pipeline.artefacts import read_white
    from reconstruction.pipeline.evidence_artefact import read_uncertainty
    from reconstruction.report.display import grey
    from reconstruction.report.pictures import write_png
    from reconstruction.training.checkpoint import load_cloud

    run = trained_run(run_folder)
    frames = frames_to_render(cameras)
    cloud = load_cloud(run.checkpoint)
    white, uncertainty = read_white(run), read_uncertainty(run, cloud)
    if uncertainty is None:
        warn("found no evidence in the run, expected that of its report stage; no expected errors are written")
    out.mkdir(parents=True, exist_ok=True)
    progress = progress_of("render")
    for i, frame in enumerate(frames):
        view = cloud.look(frame.camera, frame.instant_s)
        write_array(out / f"{i:06d}.npy", view.intensity)
        write_array(out / f"depth_{i:06d}.npy", view.depth)
        if uncertainty:
            write_array(out / f"sd_{i:06d}.npy", uncertainty.look(frame.camera, frame.instant_s))
        write_png(out / f"{i:06d}.png", grey(view.intensity, white))
        progress((i + 1) / len(frames), f"frame {i + 1} of {len(frames)}")
    click.echo(f"{len(frames)} frames in {out}")


@click.command("evaluate")
@click.argument("run_folder", metavar="RUN", type=PATH)
@click.option("--truth", type=PATH, help="truth/ of a simulated recording; without it, spike counts judge.")
@json_option
def evaluate_command(run_folder: Path, truth: Path | None, as_json: bool) -> None:
    """Score RUN on its held-out camera; where the truth is given, beside the floors it must beat."""
    from reconstruction.pipeline.artefacts import posed, recording_of
    from reconstruction.pipeline.report_stage import evaluate_run

    run = trained_run(run_folder)
    if run.config.holdout is None:
        raise BadRunError(
            "found a run without a held-out camera", do="reconstruct with --holdout to score it", where=run_folder
        )
    known = Truth.open(truth) if truth else None
    metrics = evaluate_run(run, posed(run, recording_of(run), refined=True), known, progress_of("evaluate"))
    answer(metrics, scores(metrics), as_json=as_json)
