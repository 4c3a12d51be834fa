"""Scores a finished training: its held-out view against the truth, at its end and along the way."""

from collections.abc import Sequence
from dataclasses import replace

from acquisition.recording.reader import Recording
from reconstruction.bench.conventions import HOLDOUT, truth_of
from reconstruction.evaluation.evaluate import HeldOut, held_out_camera, score_against_truth, score_floors
from reconstruction.pipeline.artefacts import posed
from reconstruction.pipeline.span_artefacts import read_targets
from reconstruction.run import configuration
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import load_checkpoint, model_from_state
from reconstruction.truth import Truth

STAGES = configuration.STAGES[:-1]  # all but the report
METRICS = ("psnr_db", "ssim", "dynamic_psnr_db", "abs_rel", "dynamic_abs_rel", "delta_1_25")
CURVE_INSTANTS = 4  # truth instants behind each point of a curve but the last


def held_out_with_truth(recording: Recording, views: Sequence[str], camera: str = HOLDOUT) -> tuple[HeldOut, Truth]:
    """Return the held-out camera and the truth in the frame of `views`; raises BadRunError where there is no truth."""
    true = truth_of(recording)
    held_out, truth = held_out_camera(recording, camera, views, true)
    return held_out, truth or true


def score_run(run: RunFolder, recording: Recording, *, floors: bool = False) -> dict:
    """Return the scores of a trained run, its costs, and the `curve` of its snapshots by wall seconds.

    `recording` has the truth; the run may have read one derived from it, with other cameras or fewer planes. Scoring
    follows the training, so that no second of it is on the run's clock. Raises BadRunError where there is no truth.
    """
    own = posed(run, Recording.open(run.recording), refined=True)
    seen = replace(
        recording, rig=replace(own.rig, tick_rate_hz=recording.tick_rate_hz, first_tick=recording.rig.first_tick)
    )
    held_out, truth = held_out_with_truth(seen, run.plan.views, run.config.holdout or HOLDOUT)
    states = [load_checkpoint(path) for path in run.snapshots()]
    clouds = [model_from_state(state["cloud"]) for state in states]
    last = score_against_truth(clouds[-1], held_out, truth)
    levels = [score_against_truth(cloud, held_out, truth, CURVE_INSTANTS) for cloud in clouds[:-1]]
    told, made = run.document, run.document.elements
    assert told.steps is not None
    assert made is not None
    return {
        "revision": told.revision,
        "model": run.plan.model,
        "steps": told.steps,
        "steps_per_s": told.steps / told.seconds["train"],
        made.unit: made.total,
        "held_out_used": bool((run.document.poses or {}).get("held_out_used")),
        **{m: last[m] for m in METRICS if m in last},
        **{f"seconds.{s}": told.seconds[s] for s in STAGES},
        **(score_floors(held_out, truth, read_targets(run, own)) if floors else {}),
        "curve": [
            {"seconds": state["seconds"], **{m: level[m] for m in ("psnr_db", "abs_rel") if m in level}}
            for state, level in zip(states, [*levels, last], strict=True)
        ],
    }
