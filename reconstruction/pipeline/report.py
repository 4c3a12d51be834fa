"""The report stage: metrics, the error-against-time curve, pictures, the orbit, the page."""

from __future__ import annotations

from acquisition.durable import write_durably, write_json
from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.evaluation.evaluate import (
    HeldOut,
    held_out_camera,
    score_against_counts,
    score_against_truth,
    score_floors,
)
from reconstruction.evaluation.truth import Truth, spread
from reconstruction.export.viewer import write_viewer
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.metrics.poses import pose_errors
from reconstruction.pipeline.export import scene_of
from reconstruction.pipeline.poses import posed
from reconstruction.pipeline.stages import composite_sources
from reconstruction.report.curve import draw_curve
from reconstruction.report.display import depth_span_m, grey
from reconstruction.report.html import embed, report_html
from reconstruction.report.orbit import write_orbit
from reconstruction.report.pictures import depth_colours, difference, encode_png, write_png
from reconstruction.report.table import score_table
from reconstruction.run.folder import RunFolder
from reconstruction.scene_model import SceneModel
from reconstruction.training.checkpoint import load_checkpoint, load_cloud, model_from_state
from rigs.rig import object_distance_m

CURVE_INSTANTS = 4  # truth instants behind each point of the curve
SHOWN_INSTANTS = 3


def report_stage(run: RunFolder, recording: Recording, progress: Progress) -> None:
    """Score the run on its held-out camera and write everything a person looks at."""
    cloud = load_cloud(run.checkpoint)
    known = Truth.open(recording.truth) if recording.truth and run.config.holdout else None
    held_out, truth = None, None
    if run.config.holdout:
        held_out, truth = held_out_camera(recording, run.config.holdout, run.plan.views, known)
    progress(0.0, "metrics")
    metrics = evaluate_run(run, recording, truth, lambda f, m: progress(0.4 * f, m))
    write_json(run.path / "metrics.json", metrics)
    progress(0.4, "error against run time")
    _write_curve(run, held_out, truth, metrics)
    centre = held_out.camera if held_out else recording.rig.cameras[len(recording.rig.cameras) // 2]
    white = truth.white if truth else run.white()
    write_orbit(run.path / "orbit.mp4", cloud, recording.rig, centre, white, lambda f, m: progress(0.5 + 0.4 * f, m))
    if isinstance(cloud, DynamicCloud):
        write_viewer(run.path, scene_of(run, recording, cloud))
    _write_page(run, recording, cloud, truth, metrics)
    progress(1.0, f"{run.path / 'report.html'}")


def evaluate_run(run: RunFolder, recording: Recording, truth: Truth | None, progress: Progress) -> dict:
    """The document of `evaluate`: metrics on the held-out camera, or a note that there is none."""
    if run.config.holdout is None:
        return {"note": "no camera was held out: nothing to score"}
    cloud = load_cloud(run.checkpoint)
    poses = _pose_scores(run, truth)
    held_out, truth = held_out_camera(recording, run.config.holdout, run.plan.views, truth)
    if truth is None:
        note = "no truth: errors of spike counts over 32-plane windows of the held-out camera"
        return {"held_out": run.config.holdout, "note": note, **score_against_counts(cloud, held_out)}
    return {
        "held_out": run.config.holdout,
        "white": truth.white,
        **score_against_truth(cloud, held_out, truth),
        **score_floors(held_out, truth, composite_sources(run, recording), progress),
        **poses,
    }


def _pose_scores(run: RunFolder, truth: Truth | None) -> dict[str, float]:
    """How far the training cameras are off the true ones, as drawn, found and refined: `poses.drawn.rotation_deg` ...

    Nothing where the poses were given and left alone.
    """
    drawn = Recording.open(run.recording)
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


def _write_curve(run: RunFolder, held_out: HeldOut | None, truth: Truth | None, metrics: dict) -> None:
    rows = []
    for path in run.snapshots():
        state = load_checkpoint(path)
        cloud = model_from_state(state["cloud"])
        if held_out is None:
            scores = {}
        elif truth is None:
            scores = score_against_counts(cloud, held_out)
        else:
            scores = score_against_truth(cloud, held_out, truth, CURVE_INSTANTS)
        rows.append({"seconds": round(state["seconds"], 3), "steps": state["steps"], **scores})
    write_json(run.path / "error_vs_time.json", {"held_out": run.config.holdout, "rows": rows})
    metric = "psnr_db" if truth else "counts.rmse"
    if held_out is not None:
        floors = {n: metrics[f"{n}.psnr_db"] for n in ("nearest_view", "depth_blend")} if truth else {}
        caption = f"{run.config.holdout}, held out; {len(rows)} states of one run, scored after it"
        draw_curve(run.path / "error_vs_time.png", rows, metric, floors, caption)


def _write_page(run: RunFolder, recording: Recording, cloud: SceneModel, truth: Truth | None, metrics: dict) -> None:
    curve = run.path / "error_vs_time.png"
    white = truth.white if truth else run.white()
    document = {
        "title": f"Reconstruction of {recording.path.name}",
        "subtitle": f"{recording.planes} planes of {len(recording.camera_ids)} cameras at "
        f"{recording.rig.tick_rate_hz:g} Hz; "
        f"{run.document.get('steps', 0)} steps, {len(cloud)} {cloud.unit}, revision {run.document['revision']}",
        "camera": run.config.holdout or "No camera held out",
        "rows": _pictures(run, recording, cloud, truth),
        "table": score_table(metrics),
        "note": metrics.get("note", f"Linear intensity, data range {white:g} spikes per tick; means over instants."),
        "curve": embed(curve.read_bytes()) if curve.exists() else "",
        "orbit": embed((run.path / "orbit.mp4").read_bytes(), "video/mp4"),
        "seconds": run.document["seconds"],
        "decisions": run.document["plan"]["decisions"],
        "configuration": run.document["configuration"],
    }
    write_durably(run.path / "report.html", report_html(document))


def _pictures(run: RunFolder, recording: Recording, cloud: SceneModel, truth: Truth | None) -> list[list[dict]]:
    camera = recording.rig.cameras[0]
    if run.config.holdout:
        held_out, truth = held_out_camera(recording, run.config.holdout, run.plan.views, truth)
        camera = held_out.camera
    planes = truth.planes(camera.id) if truth else list(range(recording.planes))
    white = truth.white if truth else run.white()
    (run.path / "thumbnails").mkdir(exist_ok=True)
    rows = []
    for plane in spread(planes, SHOWN_INSTANTS + 2)[1:-1] or planes[:1]:
        view = cloud.look(camera, recording.rig.clock.instant_s(plane))
        near, far = depth_span_m(view.depth)
        shown = {"render": grey(view.intensity, white), "depth": depth_colours(view.depth, near, far)}
        if truth:
            frame = truth.frame(camera.id, plane)
            shown = {
                "truth": grey(frame.intensity, white),
                "render": shown["render"],
                "difference x5": difference(view.intensity, frame.intensity, white),
                f"depth, {near:.2f} to {far:.2f} m": shown["depth"],
                "true depth": depth_colours(frame.depth, near, far),
            }
        write_png(run.path / "thumbnails" / f"render_{plane:06d}.png", grey(view.intensity, white))
        rows.append([{"source": embed(encode_png(p)), "caption": f"{k}, plane {plane}"} for k, p in shown.items()])
    return rows
