"""Contact sheets of the image bench: the truth and every method at one instant, a row a scene."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream
from reconstruction.bench.clips import Truth
from reconstruction.images.methods import METHODS
from reconstruction.report.pictures import grey, write_png
from rigs.errors import Spike4dgsError

TITLE_PX = 18
GAP_PX = 4


def write_strip(path: Path, scene: str, stream: SpikeStream, plane: int, truth: Truth) -> None:
    """One row: the true light, then each method's image at `plane`, all with the scene's white; grey where refused."""
    tiles = [_tile(f"{scene}: truth", grey(truth.light, truth.white))]
    for name, method in METHODS.items():
        try:
            pixels = grey(method(stream, plane).intensity, truth.white)
        except Spike4dgsError:
            pixels = np.full(truth.light.shape, 64, dtype=np.uint8)
        tiles.append(_tile(name, pixels))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, np.concatenate(tiles, axis=1))


def write_sheet(path: Path, strips: Path) -> None:
    """All strips of a folder below one another, by name; nothing where there is none."""
    rows = [np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)) for file in sorted(strips.glob("*.png"))]
    if not rows:
        return
    width = max(row.shape[1] for row in rows)
    write_png(path, np.concatenate([np.pad(row, ((0, 0), (0, width - row.shape[1]))) for row in rows]))


def _tile(title: str, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    tile = np.pad(pixels, ((TITLE_PX, GAP_PX), (0, GAP_PX)))
    cv2.putText(tile, title, (4, TITLE_PX - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.45, 255, 1, cv2.LINE_AA)
    return tile
