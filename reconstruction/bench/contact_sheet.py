"""Draws contact sheets of the benches: a strip a scene, at one instant."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.catalog import build_scene
from acquisition.spikes.stream import SpikeStream
from reconstruction.bench.conventions import HOLDOUT, KnownRecording
from reconstruction.bench.streams import TrueImage
from reconstruction.bench.viewpoints import frames_at, viewpoints
from reconstruction.images.catalogue import methods
from reconstruction.report.display import depth_span_m, grey
from reconstruction.report.pictures import depth_colours, write_png
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import load_cloud
from rigs.errors import Spike4dgsError
from rigs.exchange.nerfstudio import load_transforms

TITLE_PX = 18
GAP_PX = 4
SHOWN = (("between", 0.1), ("beyond", 0.4), ("forward", 0.6))  # places of the viewpoints' sheet: line, metres along it
Picture = NDArray[np.uint8]


def write_strip(path: Path, tiles: Sequence[tuple[str, Picture]]) -> None:
    """Write pictures, grey [H, W] or BGR [H, W, 3], beside one another under their titles."""
    coloured = any(picture.ndim == 3 for _, picture in tiles)
    drawn = []
    for title, picture in tiles:
        whole = np.repeat(picture[..., None], 3, axis=-1) if coloured and picture.ndim == 2 else picture
        tile = np.pad(whole, ((TITLE_PX, GAP_PX), (0, GAP_PX), *[(0, 0)] * coloured))
        cv2.putText(tile, title, (4, TITLE_PX - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255,) * 3, 1, cv2.LINE_AA)
        drawn.append(tile)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, np.concatenate(drawn, axis=1))


def write_sheet(path: Path, strips: Path, most_px: int | None = None) -> None:
    """Write all strips of a folder below one another, by name, at most `most_px` wide; nothing where there is none."""
    rows = [np.asarray(cv2.imread(str(file), cv2.IMREAD_COLOR)) for file in sorted(strips.glob("*.png"))]
    if not rows:
        return
    width = max(row.shape[1] for row in rows)
    sheet = np.concatenate([np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0))) for row in rows])
    if (sheet == sheet[..., :1]).all():
        sheet = sheet[..., 0]
    if most_px is not None and width > most_px:
        size = (most_px, sheet.shape[0] * most_px // width)
        sheet = np.asarray(cv2.resize(sheet, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    write_png(path, sheet)


def method_tiles(scene: str, stream: SpikeStream, plane: int, truth: TrueImage) -> list[tuple[str, Picture]]:
    """Return the true light and each method's image at `plane`, all with the scene's white; grey where refused."""
    tiles = [(f"{scene}: truth", grey(truth.light, truth.white))]
    for name, method in methods().items():
        try:
            pixels = grey(method(stream, plane).intensity, truth.white)
        except Spike4dgsError:
            pixels = np.full(truth.light.shape, 64, dtype=np.uint8)
        tiles.append((name, pixels))
    return tiles


def run_tiles(clip: KnownRecording, run: RunFolder) -> list[tuple[str, Picture]]:
    """Return the held-out view's truth, render, five times their difference and depth, and a view never captured."""
    truth, cloud = clip.truth, load_cloud(run.snapshots()[-1])
    cameras = {c.id: c for c in load_transforms(truth.path / "cameras.json")}
    novel = next(c for c in cameras if c.startswith("novel"))
    planes = truth.planes(HOLDOUT)
    plane = planes[len(planes) // 2]
    instant_s = clip.recording.rig.clock.instant_s(plane)
    wanted, elsewhere = truth.frame(HOLDOUT, plane), truth.frame(novel, plane)
    seen, unseen = (cloud.look(cameras[c], instant_s) for c in (HOLDOUT, novel))
    near, far = depth_span_m(wanted.depth)
    return [
        (f"{clip.scene}: truth", grey(wanted.intensity, truth.white)),
        ("render", grey(seen.intensity, truth.white)),
        ("difference x5", grey(5 * np.abs(seen.intensity - wanted.intensity), truth.white)),
        (f"depth, {near:.1f} (warm) to {far:.1f} m", depth_colours(seen.depth, near, far)),
        (f"{novel}, never captured", grey(unseen.intensity, truth.white)),
        ("its difference x5", grey(5 * np.abs(unseen.intensity - elsewhere.intensity), truth.white)),
    ]


def viewpoint_tiles(clip: KnownRecording, run: RunFolder) -> list[tuple[str, Picture]]:
    """Return truth, render and depth from each place of SHOWN, at the middle of the clip."""
    scene, cloud = build_scene(clip.scene, clip.seed), load_cloud(run.snapshots()[-1])
    middle_s = cloud.clip.middle_s
    tiles = []
    for viewpoint in viewpoints(clip.recording.rig, run.plan.views, scene.center):
        if not any(viewpoint.line == line and abs(viewpoint.along_m - along) < 1e-6 for line, along in SHOWN):
            continue
        frame = frames_at(scene, viewpoint.camera, np.array([middle_s]))[0]
        view = cloud.look(viewpoint.camera, middle_s)
        where, span = f"{clip.scene}, {viewpoint.line} {viewpoint.along_m:g} m", depth_span_m(frame.depth)
        tiles += [
            (f"{where}: truth", grey(frame.intensity, scene.white)),
            ("render", grey(view.intensity, scene.white)),
            ("depth", depth_colours(view.depth, *span)),
        ]
    return tiles
