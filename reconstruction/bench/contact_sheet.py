"""Draws the contact sheet of the training bench: a strip a scene, at one instant."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.durable import write_durably
from reconstruction.bench.conventions import HOLDOUT, KnownRecording
from reconstruction.report.display import depth_span_m, grey
from reconstruction.report.pictures import depth_colours, write_png
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import load_cloud
from rigs.exchange.nerfstudio import load_transforms

TITLE_PX, GAP_PX = 18, 4
MOST_PX = 1200  # width of a sheet
JPEG_QUALITY = 85
Picture = NDArray[np.uint8]


def write_sheet(path: Path, strips: Sequence[Sequence[tuple[str, Picture]]]) -> None:
    """Write strips of titled pictures of one size, grey [H, W] or BGR [H, W, 3], below one another."""
    sheet = np.concatenate([np.concatenate([_titled(*tile) for tile in tiles], axis=1) for tiles in strips])
    height, width = sheet.shape[:2]
    if width > MOST_PX:
        size = (MOST_PX, height * MOST_PX // width)
        sheet = np.asarray(cv2.resize(sheet, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _write(path, sheet)


def stack_sheets(path: Path, sheets: Sequence[Path]) -> None:
    """Write sheets of one width below one another as one."""
    _write(path, np.concatenate([np.asarray(cv2.imread(str(sheet)), dtype=np.uint8) for sheet in sheets]))


def _write(path: Path, sheet: Picture) -> None:
    """Write a PNG, or the JPEG that the name asks for, which takes an eighth of it."""
    if path.suffix == ".jpg":
        write_durably(path, cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes())
    else:
        write_png(path, sheet)


def _titled(title: str, picture: Picture) -> Picture:
    coloured = picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=-1)
    tile = np.pad(coloured, ((TITLE_PX, GAP_PX), (0, GAP_PX), (0, 0)))
    cv2.putText(tile, title, (4, TITLE_PX - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255,) * 3, 1, cv2.LINE_AA)
    return tile


def run_tiles(clip: KnownRecording, run: RunFolder) -> list[tuple[str, Picture]]:
    """Return the held-out view's truth, render, five times their difference and depth, and a view never captured."""
    truth, cloud = clip.truth, load_cloud(run.snapshots()[-1])
    cameras = {c.id: c for c in load_transforms(truth.path / "cameras.json")}
    novel = next(c for c in cameras if c.startswith("novel"))
    wanted = clip.middle
    instant_s, elsewhere = clip.recording.rig.clock.instant_s(wanted.plane), truth.frame(novel, wanted.plane)
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
