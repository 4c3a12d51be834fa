"""Scores a run on its held-out camera, and writes everything that a person looks at."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from acquisition.durable import write_durably, write_json
from acquisition.progress import Progress, part
from acquisition.recording.reader import Recording
from reconstruction.evaluation.evaluate import score_at, score_floors
from reconstruction.evaluation.expectation import score_expectation
from reconstruction.export.viewer import write_viewer
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.spanned import SpannedScene
from reconstruction.metrics.poses import pose_errors
from reconstruction.pipeline.artefacts import posed, recording_of
from reconstruction.pipeline.evidence_artefact import read_uncertainty, write_evidence
from reconstruction.pipeline.judged import Trained, judged, truth_of
from reconstruction.pipeline.report_page import write_page
from reconstruction.pipeline.span_artefacts import read_targets
from reconstruction.pipeline.trained_scene import scene_of
from reconstruction.report.video import SHARES, trusted_share, write_orbit
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import load_checkpoint, model_from_state
from reconstruction.truth import Truth, spread
from reconstruction.uncertainty.expected_error import Uncertainty
from rigs.rig import object_distance_m

CURVE_INSTANTS = 4  # truth instants behind each point of the curve
SPAN_INSTANTS = 4  # truth instants that a span is scored on
SPAN_SCORES = ("psnr_db", "dynamic_psnr_db", "abs_rel")


def report_stage(run: RunFolder, recording: Recording, progress: Progress) -> None:
    """Score the run on its held-out camera and write everything a person looks at."""
    known = truth_of(run, recording)
    progress(0.0, "evidence of the training views")
    trained = judged(run, recording, known, again=True)
    uncertainty = write_evidence(trained, part(progress, 0, 0.1))
    metrics = _metrics(trained, known, uncertainty, part(progress, 0.1, 0.4))
    write_json(run.path / "metrics.json", metrics)
    progress(0.4, "error against run time")
    rows = _score_snapshots(trained)
    with ThreadPoolExecutor(1) as aside:  # plots are drawn while kernels have the other cores
        curve = aside.submit(_write_curve, trained, rows, metrics)
        _write_orbit(trained, uncertainty, part(progress, 0.5, 0.9))
        narrow_curve = curve.result()
    if isinstance(trained.cloud, DynamicCloud | SpannedScene):
        write_viewer(run.path, scene_of(run, trained.recording, trained.cloud))
    write_page(trained, uncertainty, metrics, narrow_curve)
    progress(1.0, f"{run.path / 'report.html'}")


def _write_orbit(trained: Trained, uncertainty: Uncertainty | None, progress: Progress) -> None:
    """Write the fly-through, on a circle that is small enough for its pictures to be trusted."""
    rig, path = trained.recording.rig, trained.run.path / "orbit.mp4"
    share = trusted_share(uncertainty, rig, trained.camera) if uncertainty else SHARES[0]
    write_orbit(path, trained.cloud, rig, trained.camera, trained.white, progress, share=share)


def evaluate_run(run: RunFolder, recording: Recording, truth: Truth | None, progress: Progress) -> dict:
    """Return the document of `evaluate`: metrics on the held-out camera, or a note that there is none."""
    trained = judged(run, recording, truth)
    return _metrics(trained, truth, read_uncertainty(run, trained.cloud), progress)


def _metrics(trained: Trained, known: Truth | None, uncertainty: Uncertainty | None, progress: Progress) -> dict:
    """Score the held-out camera; `known` is the truth in its own frame."""
    held_out, truth, scores = trained.held_out, trained.truth, trained.scores(trained.cloud)
    if held_out is None:
        return {"note": "no camera was held out: nothing to score"}
    if truth is None:
        placed = ", which its other windows have placed or measured after training" if held_out.resected else ""
        own = {} if held_out.gain == 1 else {"matched_gain": held_out.gain}  # its light over that of the scene
        note = f"no truth: errors of spike counts over 32-plane windows of the held-out camera{placed}"
        return {"held_out": held_out.camera.id, "note": note, **own, **scores, **_span_scores(trained)}
    own = {"matched_gain": truth.gain, "matched_lag_ticks": truth.lag_ticks}  # of the truth, to the training cameras'
    return {
        "held_out": held_out.camera.id,
        "white": truth.white,
        **(own if own != {"matched_gain": 1.0, "matched_lag_ticks": 0.0} else {}),
        **scores,
        **_span_scores(trained),
        **(score_expectation(uncertainty, held_out, truth) if uncertainty else {}),
        **score_floors(held_out, truth, read_targets(trained.run, trained.recording), progress),
        **_pose_scores(trained.run, known),
    }


def _span_scores(trained: Trained) -> dict[str, list[dict[str, float]]]:
    """Return `spans`, where the scene has any: the first and the last plane of each, its scores, and its seconds."""
    cloud, held_out, truth = trained.cloud, trained.held_out, trained.truth
    if not isinstance(cloud, SpannedScene) or held_out is None:
        return {}
    seconds = load_checkpoint(trained.run.checkpoint)["seconds"]
    rows, begin = [], trained.recording.rig.first_tick
    for number, span in enumerate(trained.run.plan.spans):
        known = truth.planes(held_out.camera.id) if truth else []
        planes = [plane for plane in known if span.first <= plane < span.last]
        scores = score_at(cloud, held_out, truth, spread(planes, SPAN_INSTANTS)) if truth and planes else {}
        kept = {name: scores[name] for name in SPAN_SCORES if name in scores}
        took_s = seconds.get(f"span {number}", 0.0)
        ends = {"first_tick": begin + span.first, "last_tick": begin + span.last - 1}
        rows.append({**ends, **kept, "seconds": round(took_s, 3)})
    return {"spans": rows}


def _pose_scores(run: RunFolder, truth: Truth | None) -> dict[str, float]:
    """Return how far the training cameras are off the true ones: `poses.drawn.rotation_deg`, then found and refined.

    Returns nothing where the poses were given and left alone.
    """
    drawn = recording_of(run)
    true = truth.cameras(drawn.tick_rate_hz) if truth else None
    stages = {"drawn": drawn, "found": posed(run, drawn), "refined": posed(run, drawn, refined=True)}
    if true is None or stages["refined"] is drawn or not set(run.plan.views) <= set(true.ids):
        return {}
    distance_m, scores = object_distance_m(true.cameras), {}
    for name, recording in stages.items():
        off = pose_errors(recording.rig.only(run.plan.views), true, distance_m)
        for score in ("rotation_deg", "translation_percent", "focal_percent"):
            scores[f"poses.{name}.{score}"] = getattr(off, score)
    return scores


def _score_snapshots(trained: Trained) -> list[dict]:
    """Write the rows of the curve, one a snapshot, and return them."""
    run, rows = trained.run, []
    for path in run.snapshots():
        state = load_checkpoint(path)
        scores = trained.scores(model_from_state(state["cloud"]), CURVE_INSTANTS)
        rows.append({"seconds": round(state["seconds"], 3), "steps": state["steps"], **scores})
    write_json(run.path / "error_vs_time.json", {"held_out": run.config.holdout, "rows": rows})
    return rows


def _write_curve(trained: Trained, rows: Sequence[dict], metrics: dict) -> bytes:
    """Write the picture of the curve; return the one for a telephone, empty where no camera was held out."""
    if trained.held_out is None:
        return b""
    from reconstruction.report.curve import curve_png  # whose import takes half a second

    run, truth = trained.run, trained.truth
    metric = "psnr_db" if truth else "counts.rmse"
    floors = {n: metrics[f"{n}.psnr_db"] for n in ("nearest_view", "depth_blend")} if truth else {}
    caption = f"{run.config.holdout}, held out; {len(rows)} states of one run, scored after it"
    write_durably(run.path / "error_vs_time.png", curve_png(rows, metric, floors, caption))
    return curve_png(rows, metric, floors, caption, narrow=True)
