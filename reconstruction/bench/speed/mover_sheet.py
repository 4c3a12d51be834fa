"""Draws what runs make of movers, enlarged: the part of the held-out view in which most pixels move."""

import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import read_array
from acquisition.durable import write_durably
from reconstruction.bench.contact_sheet import Picture, write_sheet
from reconstruction.bench.conventions import HOLDOUT, KnownRecording
from reconstruction.bench.speed.run import Contender
from reconstruction.errors import ReconstructionError
from reconstruction.report.display import grey
from rigs.exchange.nerfstudio import Frame, dump_frames

SHARE = 0.3  # of the view's width and height that is enlarged
ZOOM = 3
GAIN = 5  # of differences
FRAME_PX = 2  # width of the frame that marks the enlarged part in the whole view


def shoot(contender: Contender, clip: KnownRecording, run: Path, image: Path) -> None:
    """Render the held-out view of a run at the middle of its truth by the revision's own command, and keep it.

    `image` becomes light [H, W] in spikes per tick. Raises ReconstructionError where the command fails.
    """
    cameras, out = run / "held_out.json", run / "held_out"
    camera = next(one for one in clip.rig.cameras if one.id == HOLDOUT)
    instant_s = clip.recording.rig.clock.instant_s(clip.middle.plane)
    write_durably(cameras, dump_frames([Frame(camera, instant_s)], ["000000.png"]).encode())
    command = [*contender.words, "render", str(run), "--cameras", str(cameras), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, env=contender.environment())
    if done.returncode:
        raise ReconstructionError(f"found exit code {done.returncode} of render", "0", where=contender.said)
    image.parent.mkdir(parents=True, exist_ok=True)
    write_durably(image, (out / "000000.npy").read_bytes())


def write_mover_sheet(path: Path, clips: Sequence[tuple[KnownRecording, dict[str, Path]]]) -> None:
    """Write two strips for each clip: truth and images, and below them the view and the differences from truth.

    A clip has the files of its images by their titles, the same titles in all clips. One that is not there is black.
    """
    shown = [(clip, {t: read_array(f) if f.exists() else None for t, f in files.items()}) for clip, files in clips]
    write_sheet(path, [strip for clip, images in shown for strip in mover_strips(clip, images)])


def mover_strips(
    clip: KnownRecording, images: Mapping[str, NDArray[np.float32] | None]
) -> list[list[tuple[str, Picture]]]:
    """Return two strips of a clip: the truth and `images` [H, W] of the held-out view, below them the differences.

    `images` have titles; one that is None is black.
    """
    frame, white = clip.middle, clip.truth.white
    crop, truth = most_moving(frame.moving), grey(frame.intensity, white)
    above = [(f"{clip.scene}: truth", _enlarged(truth, crop))]
    below = [("what is enlarged", _framed(truth, crop))]
    for title, image in images.items():
        if image is None:
            missing = np.zeros_like(above[0][1])
            above, below = [*above, (f"{title}: none", missing)], [*below, ("", missing)]
            continue
        above.append((title, _enlarged(grey(image, white), crop)))
        below.append((f"difference x{GAIN}", _enlarged(grey(GAIN * np.abs(image - frame.intensity), white), crop)))
    return [above, below]


def most_moving(moving: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the rows and columns of SHARE of a view [H, W] with the most pixels that move; the first of equal ones."""
    height, width = (max(1, round(SHARE * size)) for size in moving.shape)
    sums = np.pad(moving.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    inside = sums[height:, width:] - sums[:-height, width:] - sums[height:, :-width] + sums[:-height, :-width]
    row, column = np.unravel_index(int(inside.argmax()), inside.shape)
    return slice(row, row + height), slice(column, column + width)


def _enlarged(picture: Picture, crop: tuple[slice, slice]) -> Picture:
    return picture[crop].repeat(ZOOM, axis=0).repeat(ZOOM, axis=1)


def _framed(picture: Picture, crop: tuple[slice, slice]) -> Picture:
    """Return the whole view as large as what is enlarged of it, with a frame around that."""
    rows, columns = crop
    framed = picture.copy()
    cv2.rectangle(framed, (columns.start, rows.start), (columns.stop - 1, rows.stop - 1), 255, FRAME_PX)
    size = (ZOOM * (columns.stop - columns.start), ZOOM * (rows.stop - rows.start))
    return np.asarray(cv2.resize(framed, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
