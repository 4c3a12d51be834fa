"""Contact sheets of the image and training benches: a row a scene, at one instant."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.recording.reader import Recording
from acquisition.spikes.stream import SpikeStream
from reconstruction.bench.clips import Truth
from reconstruction.evaluation.truth import Truth as RunTruth
from reconstruction.images.catalogue import methods
from reconstruction.report.pictures import depth_span_m, grey, write_png
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import load_cloud
from rigs.errors import Spike4dgsError
from rigs.exchange.nerfstudio import load_transforms

TITLE_PX = 18
GAP_PX = 4


def write_strip(path: Path, scene: str, stream: SpikeStream, plane: int, truth: Truth) -> None:
    """One row: the true light, then each method's image at `plane`, all with the scene's white; grey where refused."""
    tiles = [_tile(f"{scene}: truth", grey(truth.light, truth.white))]
    for name, method in methods().items():
        try:
            pixels = grey(method(stream, plane).intensity, truth.white)
        except Spike4dgsError:
            pixels = np.full(truth.light.shape, 64, dtype=np.uint8)
        tiles.append(_tile(name, pixels))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, np.concatenate(tiles, axis=1))


def write_run_strip(path: Path, run_folder: Path) -> None:
    """One row: the held-out camera's truth, the render, five times their difference, depth, a view never captured."""
    run = RunFolder.open(run_folder)
    recording = Recording.open(run.recording)
    assert recording.truth is not None
    assert run.config.holdout is not None
    truth, cloud = RunTruth.open(recording.truth), load_cloud(run.checkpoint)
    cameras = {c.id: c for c in load_transforms(recording.truth / "cameras.json")}
    novel = next(c for c in cameras if c.startswith("novel"))
    planes = truth.planes(run.config.holdout)
    plane = planes[len(planes) // 2]
    instant_s = recording.rig.clock.instant_s(plane)
    wanted, elsewhere = truth.frame(run.config.holdout, plane), truth.frame(novel, plane)
    seen, unseen = (cloud.look(cameras[c], instant_s) for c in (run.config.holdout, novel))
    near, far = depth_span_m(wanted.depth)
    tiles = [
        (f"{run_folder.name}: truth", grey(wanted.intensity, truth.white)),
        ("render", grey(seen.intensity, truth.white)),
        ("difference x5", grey(5 * np.abs(seen.intensity - wanted.intensity), truth.white)),
        (f"depth, {near:.1f} (bright) to {far:.1f} m", _nearness(seen.depth, near, far)),
        (f"{novel}, never captured", grey(unseen.intensity, truth.white)),
        ("its difference x5", grey(5 * np.abs(unseen.intensity - elsewhere.intensity), truth.white)),
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, np.concatenate([_tile(title, pixels) for title, pixels in tiles], axis=1))


def _nearness(depth: NDArray[np.float32], near_m: float, far_m: float) -> NDArray[np.uint8]:
    """Depth [H, W] as grey: white at `near_m`, black at `far_m` and where there is none."""
    shown = np.clip((far_m - np.nan_to_num(depth, nan=far_m)) / (far_m - near_m), 0, 1)
    return (255 * shown).astype(np.uint8)


def write_sheet(path: Path, strips: Path, most_px: int | None = None) -> None:
    """All strips of a folder below one another, by name, at most `most_px` wide; nothing where there is none."""
    rows = [np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)) for file in sorted(strips.glob("*.png"))]
    if not rows:
        return
    width = max(row.shape[1] for row in rows)
    sheet = np.concatenate([np.pad(row, ((0, 0), (0, width - row.shape[1]))) for row in rows])
    if most_px is not None and width > most_px:
        size = (most_px, sheet.shape[0] * most_px // width)
        sheet = np.asarray(cv2.resize(sheet, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    write_png(path, sheet)


def _tile(title: str, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    tile = np.pad(pixels, ((TITLE_PX, GAP_PX), (0, GAP_PX)))
    cv2.putText(tile, title, (4, TITLE_PX - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.45, 255, 1, cv2.LINE_AA)
    return tile
