"""Pictures of the viewpoint bench: error against distance, a sheet of views nobody captured, a fly-through a scene."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from acquisition.durable import write_durably
from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from acquisition.scenes.catalog import build_scene
from reconstruction.bench.training import Clip
from reconstruction.bench.viewpoints import frames_at, viewpoints
from reconstruction.report.orbit import write_orbit
from reconstruction.report.pictures import depth_colours, depth_span_m, grey, write_png
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import load_cloud

PANELS = (
    ("psnr_db", "PSNR / dB"),
    ("abs_rel", "Abs Rel of the depth"),
    ("empty", "share of pixels left empty"),
)
SHRUNK = 0.25  # of the sheet: noise-like textures make large files
LINES = ("between", "beyond", "forward", "backward")
SHOWN = (("between", 0.1), ("beyond", 0.4), ("forward", 0.6))  # what the sheet has of each scene


def plot_viewpoints(path: Path, document: dict) -> None:
    """Each line's mean over the scenes (thick) and each scene (thin), by metres along the line."""
    figure = Figure(figsize=(11, 7.6), layout="constrained")
    FigureCanvasAgg(figure)
    for row, (score, label) in zip(figure.subplots(len(PANELS), len(LINES), sharey="row"), PANELS, strict=True):
        for axes, line in zip(row, LINES, strict=True):
            _panel(axes, [r for r in document["rows"] if r["line"] == line and score in r], score)
            if score == "abs_rel":
                axes.set_yscale("log")
            axes.grid(True, which="both", alpha=0.3)
            if row[0] is axes:
                axes.set_ylabel(label)
            if score == PANELS[0][0]:
                axes.set_title(line)
            if score == PANELS[-1][0]:
                axes.set_xlabel("metres along the line")
    device = document["device"]
    figure.suptitle(
        "views nobody captured; cameras stand at -0.2, 0 and 0.2 m; black: mean of the scenes\n"
        f"{device['processor']}, {device['threads']} threads; revision {document['revision']}",
        fontsize=9,
    )
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    write_durably(path, buffer.getvalue())


def _panel(axes: Axes, rows: list[dict], score: str) -> None:
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    for i, scene in enumerate(scenes):
        own = sorted((r["along_m"], r[score]) for r in rows if r["scene"] == scene)
        axes.plot(*zip(*own, strict=True), color=f"C{i}", linewidth=0.8, alpha=0.7)
    places = sorted({row["along_m"] for row in rows})
    means = [np.mean([r[score] for r in rows if r["along_m"] == place]) for place in places]
    axes.plot(places, means, "k.-", linewidth=1.8)


def write_viewpoint_sheet(path: Path, clips: Sequence[Clip], runs: Sequence[RunFolder]) -> None:
    """A row a scene: truth, render and depth from each place of SHOWN, at the middle of the clip."""
    rows = []
    for clip, run in zip(clips, runs, strict=True):
        scene, cloud = build_scene(clip.scene, clip.seed), load_cloud(run.snapshots()[-1])
        middle_s = (cloud.clip.first_s + cloud.clip.last_s) / 2
        tiles = []
        for viewpoint in viewpoints(Recording.open(clip.path).rig, run.plan.views, scene.center):
            if not any(viewpoint.line == line and abs(viewpoint.along_m - along) < 1e-6 for line, along in SHOWN):
                continue
            frame = frames_at(scene, viewpoint.camera, np.array([middle_s]))[0]
            view = cloud.look(viewpoint.camera, middle_s)
            near, far = depth_span_m(frame.depth)
            depth = depth_colours(view.depth, near, far)
            truth, render = (cv2.cvtColor(grey(a.intensity, scene.white), cv2.COLOR_GRAY2BGR) for a in (frame, view))
            tiles += [truth, render, depth]
        strip = np.concatenate(tiles, axis=1)
        rows.append(cv2.resize(strip, None, fx=SHRUNK, fy=SHRUNK, interpolation=cv2.INTER_AREA))
    write_png(path, np.concatenate(rows))


def write_flythroughs(folder: Path, clips: Sequence[Clip], runs: Sequence[RunFolder], progress: Progress) -> None:
    """SCENE.mp4 for each: intensity beside depth, while the camera circles and the clip plays once."""
    folder.mkdir(parents=True, exist_ok=True)
    for i, (clip, run) in enumerate(zip(clips, runs, strict=True)):
        rig, cloud = Recording.open(clip.path).rig, load_cloud(run.snapshots()[-1])
        centre, white = rig.camera(run.config.holdout or rig.ids[0]), build_scene(clip.scene, clip.seed).white
        write_orbit(folder / f"{clip.scene}.mp4", cloud, rig, centre, white, progress)
        progress((i + 1) / len(clips), f"fly-through of {clip.scene}")
