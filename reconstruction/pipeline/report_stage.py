"""Scores a run on its held-out camera, and writes everything that a person looks at."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace

from acquisition.durable import write_durably, write_json
from acquisition.progress import Progress, part
from acquisition.recording.reader import Recording
from reconstruction.evaluation.evaluate import (
    INSTANTS,
    HeldOut,
    gained_by_spikes,
    held_out_camera,
    placed_by_spikes,
    score_against_counts,
    score_against_truth,
    score_at,
    score_floors,
)
from reconstruction.export.viewer import write_viewer
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.spanned import SpannedScene
from reconstruction.metrics.poses import pose_errors
from reconstruction.native import shared_out
from reconstruction.pipeline.artefacts import (
    gains_differ,
    posed,
    read_held_out,
    read_white,
    recording_of,
    write_held_out,
)
from reconstruction.pipeline.span_artefacts import read_targets
from reconstruction.pipeline.trained_scene import scene_of
from reconstruction.report.display import depth_span_m, grey
from reconstruction.report.html import embed, report_html
from reconstruction.report.pictures import depth_colours, difference, encode_png
from reconstruction.report.table import score_table
from reconstruction.report.video import write_orbit
from reconstruction.run.folder import RunFolder
from reconstruction.scene_model import SceneModel
from reconstruction.training.checkpoint import load_checkpoint, load_cloud, model_from_state
from reconstruction.truth import Truth, spread
from rigs.camera import Camera
from rigs.rig import object_distance_m

CURVE_INSTANTS = 4  # truth instants behind each point of the curve
SPAN_INSTANTS = 4  # truth instants that a span is scored on
SPAN_SCORES = ("psnr_db", "dynamic_psnr_db", "abs_rel")
SHOWN_INSTANTS = 3  # instants in the report's pictures


@dataclass(frozen=True)
class Trained:
    """A trained run: its model, the recording with the cameras it ended with, and how it is judged.

    `truth`: what is known of the scene, in the frame of the run. `held_out`: the camera in its place, None where none
    was held out.
    """

    run: RunFolder
    recording: Recording
    cloud: SceneModel
    truth: Truth | None
    held_out: HeldOut | None

    @property
    def white(self) -> float:
        """The intensity shown as white, spikes per tick."""
        return self.truth.white if self.truth else read_white(self.run)

    @property
    def camera(self) -> Camera:
        """The held-out camera, or the rig's middle one."""
        cameras = self.recording.rig.cameras
        return self.held_out.camera if self.held_out else cameras[len(cameras) // 2]

    def scores(self, cloud: SceneModel, instants: int = INSTANTS) -> dict[str, float]:
        """Score a state of the model on the held-out camera: against the truth at so many instants, or the counts."""
        if self.held_out is None:
            return {}
        if self.truth is None:
            return score_against_counts(cloud, self.held_out)
        return score_against_truth(cloud, self.held_out, self.truth, instants)


def report_stage(run: RunFolder, recording: Recording, progress: Progress) -> None:
    """Score the run on its held-out camera and write everything a person looks at."""
    known = _truth_of(run, recording)
    progress(0.0, "metrics")
    trained = judged(run, recording, known, again=True)
    metrics = _metrics(trained, known, part(progress, 0, 0.4))
    write_json(run.path / "metrics.json", metrics)
    progress(0.4, "error against run time")
    rows = _score_snapshots(trained)
    rig, orbit = trained.recording.rig, run.path / "orbit.mp4"
    with ThreadPoolExecutor(1) as aside:  # plots are drawn while kernels have the other cores
        curve = aside.submit(_write_curve, trained, rows, metrics)
        write_orbit(orbit, trained.cloud, rig, trained.camera, trained.white, part(progress, 0.5, 0.9))
        narrow_curve = curve.result()
    if isinstance(trained.cloud, DynamicCloud | SpannedScene):
        write_viewer(run.path, scene_of(run, trained.recording, trained.cloud))
    _write_page(trained, metrics, narrow_curve)
    progress(1.0, f"{run.path / 'report.html'}")


def _truth_of(run: RunFolder, recording: Recording) -> Truth | None:
    """Return the truth of a simulated recording; None where there is none, or none in the part that was learnt."""
    if recording.truth is None or run.config.holdout is None:
        return None
    truth = Truth.open(recording.truth).within(recording.ticks)
    return truth if recording.part_planes is None or truth.knows(run.config.holdout) else None


def evaluate_run(run: RunFolder, recording: Recording, truth: Truth | None, progress: Progress) -> dict:
    """Return the document of `evaluate`: metrics on the held-out camera, or a note that there is none."""
    return _metrics(judged(run, recording, truth), truth, progress)


def judged(run: RunFolder, recording: Recording, known: Truth | None, *, again: bool = False) -> Trained:
    """Return the trained run with its held-out camera in its place.

    With truth that is the true place, in the light of the training cameras. Without it, a camera that no pose
    estimation has seen is placed by its spikes, as the report kept it, or anew and then kept where `again`; and where
    the cameras differ in gain, its spikes tell its own.
    """
    cloud, camera_id = load_cloud(run.checkpoint), run.config.holdout
    known = known and known.within(recording.ticks)
    if camera_id is None:
        return Trained(run, recording, cloud, known, None)
    held_out, truth = held_out_camera(recording, camera_id, run.plan.views, known)
    estimated = run.document.held_out_used is False and posed(run, recording, refined=True) is not recording
    if truth is None and estimated:
        kept = None if again else read_held_out(run)
        placed = replace(held_out, camera=kept, resected=True) if kept else placed_by_spikes(cloud, held_out)
        if again and placed.resected:
            write_held_out(run, recording.rig, placed.camera)
        held_out = placed
    if truth is None and gains_differ(run):
        held_out = gained_by_spikes(cloud, held_out)
    return Trained(run, recording, cloud, truth, held_out)


def _metrics(trained: Trained, known: Truth | None, progress: Progress) -> dict:
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


def _write_page(trained: Trained, metrics: dict, narrow_curve: bytes) -> None:
    from reconstruction.report.curve import along_png

    along = along_png(metrics.get("spans", ()))
    run, recording, cloud = trained.run, trained.recording, trained.cloud
    curve, told = run.path / "error_vs_time.png", run.document
    document = {
        "title": f"Reconstruction of {recording.path.name}",
        "subtitle": f"{recording.planes} planes{_part_of(recording)} of {len(recording.camera_ids)} cameras at "
        f"{recording.rig.tick_rate_hz:g} Hz; "
        f"{told.steps or 0} steps, {len(cloud)} {cloud.unit}, revision {told.revision}",
        "camera": run.config.holdout or "No camera held out",
        "rows": _pictures(trained),
        "table": score_table(metrics),
        "note": metrics.get(
            "note", f"Linear intensity, data range {trained.white:g} spikes per tick; means over instants."
        ),
        "curve": embed(curve.read_bytes()) if curve.exists() else "",
        "narrow_curve": embed(narrow_curve),
        "along": embed(along) if along else "",
        "orbit": embed((run.path / "orbit.mp4").read_bytes(), "video/mp4"),
        "seconds": told.seconds,
        "warnings": list(told.warnings.values()),
        "decisions": run.plan.decisions,
        "configuration": asdict(told.configuration),
    }
    write_durably(run.path / "report.html", report_html(document))


def _part_of(recording: Recording) -> str:
    """Return the words that tell which part of a recording this is; none for a whole one."""
    if recording.part_planes is None:
        return ""
    return f" (ticks {recording.ticks.start} to {recording.ticks.stop - 1})"


def _pictures(trained: Trained) -> list[list[dict]]:
    """Write thumbnails, and return the pictures of each instant as the page shows them."""
    run, recording, truth, white = trained.run, trained.recording, trained.truth, trained.white
    camera = trained.held_out.camera if trained.held_out else recording.rig.cameras[0]
    planes = truth.planes(camera.id) if truth else list(range(recording.planes))
    (run.path / "thumbnails").mkdir(exist_ok=True)

    def drawn(plane: int) -> list[dict]:
        view = trained.cloud.look(camera, recording.rig.clock.instant_s(plane))
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
        files = {name: encode_png(pixels) for name, pixels in shown.items()}
        tick = recording.rig.first_tick + plane
        write_durably(run.path / "thumbnails" / f"render_{tick:06d}.png", files["render"])
        return [{"source": embed(file), "caption": f"{name}, plane {tick}"} for name, file in files.items()]

    return list(shared_out(drawn, spread(planes, SHOWN_INSTANTS + 2)[1:-1] or planes[:1]))
