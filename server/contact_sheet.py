"""Draws what the cameras of a recording saw, as bright as a person wants to see it."""

import io
import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from acquisition.recording.reader import Recording
from reconstruction.report.display import grey
from rigs.toml import GRID_ID
from server.figures import figures_of
from server.schemas.pictures import CameraFigures

WINDOW_PLANES = 200  # 10 ms at 20 kHz: enough spikes to see by, and little blur
_CELL = 400  # pixels a side, at most
_GAP = 4
_WHITE_PERCENTILE = 99.5
_LEAST_WHITE = 1e-3  # spikes per tick; what is darker than that stays dark


def middle_mean(recording: Recording, camera_id: str) -> NDArray[np.float32] | None:
    """Mean of the planes in the middle of a stream, spikes per tick [H, W]; None where there is no plane."""
    counts, planes = _middle_counts(recording, camera_id)
    return counts.astype(np.float32) / np.float32(planes) if planes else None


def figures(recording: Recording) -> list[CameraFigures]:
    """Return the sharpness and light of the pictures of all cameras."""
    found = []
    for camera_id, (row, column) in _places(list(recording.camera_ids)).items():
        counts, planes = _middle_counts(recording, camera_id)
        known = {"id": camera_id, "row": row, "column": column, "planes": planes, "width": counts.shape[1]}
        found.append(CameraFigures.model_validate(known | {"height": len(counts)} | figures_of(counts, planes)))
    return found


def camera_picture(recording: Recording, camera_id: str) -> bytes:
    """One camera as PNG in its own size; black where it has no plane. Raises BadRecordingError for no such camera."""
    mean = middle_mean(recording, camera_id)
    layout = recording.manifest.camera(camera_id).layout
    if mean is None:
        return _png(Image.new("L", (layout.width, layout.height)))
    return mean_picture(mean)


def mean_picture(mean: NDArray[np.float32]) -> bytes:
    """Spikes per tick [H, W] as PNG, as bright as they need to be seen."""
    return _png(_shown(mean, _white(mean)))


def contact_sheet(recording: Recording) -> bytes:
    """All cameras as one PNG, where they stand in the grid, equally bright; black where one has no plane.

    White is the median of the cameras' own whites, so that one camera in the dark or in the sun leaves the others as
    they are.
    """
    means = {camera_id: middle_mean(recording, camera_id) for camera_id in recording.camera_ids}
    whites = [_white(mean) for mean in means.values() if mean is not None]
    white = float(np.median(whites)) if whites else 1.0
    cells = {}
    for camera_id, mean in means.items():
        layout = recording.manifest.camera(camera_id).layout
        cell = Image.new("L", (layout.width, layout.height)) if mean is None else _shown(mean, white)
        cell.thumbnail((_CELL, _CELL))
        cells[camera_id] = cell
    return _png(_arranged(cells))


def _middle_counts(recording: Recording, camera_id: str) -> tuple[NDArray[np.uint32], int]:
    """Spikes [H, W] of the planes in the middle of a stream, and how many planes those are."""
    entry = recording.manifest.camera(camera_id)
    if not entry.planes:
        return np.zeros((entry.layout.height, entry.layout.width), np.uint32), 0
    stream = recording.stream(camera_id)
    first = max(0, len(stream) // 2 - WINDOW_PLANES // 2)
    last = min(len(stream), first + WINDOW_PLANES)
    return stream.counts(first, last), last - first


def _arranged(cells: dict[str, Image.Image]) -> Image.Image:
    places = _places(list(cells))
    width, height = (max(cell.size[axis] for cell in cells.values()) for axis in (0, 1))
    columns, rows = (1 + max(place[axis] for place in places.values()) for axis in (1, 0))
    sheet = Image.new("L", (columns * (width + _GAP) - _GAP, rows * (height + _GAP) - _GAP), 255)
    draw = ImageDraw.Draw(sheet)
    for camera_id, (row, column) in places.items():
        corner = column * (width + _GAP), row * (height + _GAP)
        sheet.paste(cells[camera_id], corner)
        draw.text((corner[0] + 4, corner[1] + 2), camera_id, fill=255, stroke_width=1, stroke_fill=0)
    return sheet


def _places(camera_ids: list[str]) -> dict[str, tuple[int, int]]:
    """Row and column of each camera: as its id says or, where one does not, in their order."""
    found = {camera_id: GRID_ID.fullmatch(camera_id) for camera_id in camera_ids}
    if all(found.values()):
        return {camera_id: (int(m[1]), int(m[2])) for camera_id, m in found.items() if m}
    columns = math.ceil(math.sqrt(len(camera_ids)))
    return {camera_id: divmod(number, columns) for number, camera_id in enumerate(camera_ids)}


def _white(mean: NDArray[np.float32]) -> float:
    return max(float(np.percentile(mean, _WHITE_PERCENTILE)), _LEAST_WHITE)


def _shown(mean: NDArray[np.float32], white: float) -> Image.Image:
    return Image.fromarray(grey(mean, white))


def _png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG", compress_level=3)
    return buffer.getvalue()
