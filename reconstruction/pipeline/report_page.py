"""Writes the page of a report, with the pictures on it."""

from dataclasses import asdict

from acquisition.durable import write_durably
from acquisition.recording.reader import Recording
from reconstruction.native import shared_out
from reconstruction.pipeline.judged import Trained
from reconstruction.report.display import depth_span_m, grey
from reconstruction.report.html import embed, report_html
from reconstruction.report.pictures import depth_colours, encode_png, error_colours
from reconstruction.report.seen import seen
from reconstruction.report.table import score_table
from reconstruction.truth import spread
from reconstruction.uncertainty.expected_error import Uncertainty

SHOWN_INSTANTS = 3  # instants in the report's pictures


def write_page(trained: Trained, uncertainty: Uncertainty | None, metrics: dict, narrow_curve: bytes) -> None:
    """Write `report.html` and the thumbnails of a run; `narrow_curve` is the picture for a telephone, if any."""
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
        "rows": _pictures(trained, uncertainty),
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


def _pictures(trained: Trained, uncertainty: Uncertainty | None) -> list[list[dict]]:
    """Write thumbnails, and return the pictures of each instant as the page shows them."""
    run, recording, truth, white = trained.run, trained.recording, trained.truth, trained.white
    camera = trained.held_out.camera if trained.held_out else recording.rig.cameras[0]
    planes = truth.planes(camera.id) if truth else list(range(recording.planes))
    (run.path / "thumbnails").mkdir(exist_ok=True)

    def drawn(plane: int) -> list[dict]:
        instant_s = recording.rig.clock.instant_s(plane - (truth.lag_ticks if truth else 0.0))
        view = trained.cloud.look(camera, instant_s)
        near, far = depth_span_m(view.depth)
        frame = truth.frame(camera.id, plane) if truth else None
        first = "truth" if frame else f"what {camera.id} saw, by its spikes"
        shown = {first: grey(frame.intensity, white) if frame else seen(recording.stream(camera.id), plane, white)}
        shown["render"] = grey(view.intensity, white)
        if frame:
            shown["error x5"] = error_colours(view.intensity - frame.intensity, white)
        if uncertainty:
            shown["expected error x5"] = error_colours(uncertainty.look(camera, instant_s), white)
        shown[f"depth, {near:.2f} to {far:.2f} m"] = depth_colours(view.depth, near, far)
        if frame:
            shown["true depth"] = depth_colours(frame.depth, near, far)
        files = {name: encode_png(pixels) for name, pixels in shown.items()}
        tick = recording.rig.first_tick + plane
        write_durably(run.path / "thumbnails" / f"render_{tick:06d}.png", files["render"])
        return [{"source": embed(file), "caption": f"{name}, plane {tick}"} for name, file in files.items()]

    return list(shared_out(drawn, spread(planes, SHOWN_INSTANTS + 2)[1:-1] or planes[:1]))
