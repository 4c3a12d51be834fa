"""What a finished training is worth: its held-out view against truth, at its end and along the way."""

from __future__ import annotations

from dataclasses import replace

from acquisition.recording.reader import Recording
from reconstruction.bench.variants import HOLDOUT
from reconstruction.errors import BadRunError
from reconstruction.evaluation.evaluate import held_out_camera, score_against_truth, score_floors
from reconstruction.evaluation.truth import Truth
from reconstruction.pipeline.poses import posed
from reconstruction.pipeline.stages import composite_sources
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import load_checkpoint, model_from_state

STAGES = ("plan", "poses", "images", "points", "train")
METRICS = ("psnr_db", "ssim", "dynamic_psnr_db", "abs_rel", "dynamic_abs_rel", "delta_1_25")
CURVE_INSTANTS = 4  # truth instants behind each point of a curve but the last


def score_run(run: RunFolder, recording: Recording, *, floors: bool = False) -> dict:
    """Scores of a trained run, its costs, and the `curve` of its snapshots: PSNR and depth after so many wall seconds.

    `recording` has the truth; the run may have read one derived from it, with other cameras or fewer planes. Scoring
    lies behind the training, so that no second of it is on the run's clock.
    """
    if recording.truth is None:
        raise BadRunError("found no truth", "a simulated recording to score against", where=recording.path)
    own = posed(run, Recording.open(run.recording), refined=True)
    seen = replace(recording, rig=replace(own.rig, tick_rate_hz=recording.tick_rate_hz))
    held_out, truth = held_out_camera(seen, HOLDOUT, run.plan.views, Truth.open(recording.truth))
    assert truth is not None
    states = [load_checkpoint(path) for path in run.snapshots()]
    clouds = [model_from_state(state["cloud"]) for state in states]
    last = score_against_truth(clouds[-1], held_out, truth)
    levels = [score_against_truth(cloud, held_out, truth, CURVE_INSTANTS) for cloud in clouds[:-1]]
    seconds, unit = run.document["seconds"], clouds[-1].unit.lower()
    return {
        "revision": run.document["revision"],
        "model": run.plan.model,
        "steps": run.document["steps"],
        "steps_per_s": run.document["steps"] / seconds["train"],
        unit: sum(run.document[unit].values()),
        **{m: last[m] for m in METRICS if m in last},
        **{f"seconds.{s}": seconds[s] for s in STAGES},
        **(score_floors(held_out, truth, composite_sources(run, own)) if floors else {}),
        "curve": [
            {"seconds": state["seconds"], **{m: level[m] for m in ("psnr_db", "abs_rel") if m in level}}
            for state, level in zip(states, [*levels, last], strict=True)
        ],
    }
