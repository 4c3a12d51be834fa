"""Draws the residuals of a calibration: each camera's vectors, and their spread."""

import io
import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from acquisition.durable import write_durably
from reconstruction.calibration.calibrated import Calibrated
from rigs.camera import Camera
from rigs.toml import GRID_ID
from rigs.transform import Floats

MOST_ARROWS = 600  # a camera
ARROW_SHARE = 0.06  # length of the arrow of the 95th percentile of residuals, as a share of the width
COLOUR = "#1f5fa8"


def draw_residuals(path: Path, found: Calibrated) -> None:
    """Write a PNG: a panel a camera, laid out like the rig, with residuals drawn larger by a stated factor.

    Below, how long the vectors of each camera are, and all residuals about their middle.
    """
    cameras = [camera for camera in found.rig.cameras if camera.id in found.residuals]
    rows, columns, cells = _grid([camera.id for camera in cameras])
    lengths = np.concatenate([np.linalg.norm(found.residuals[c.id][:, 2:], axis=1) for c in cameras])
    usual = float(np.percentile(lengths, 95)) if len(lengths) else 1.0
    times = _round(ARROW_SHARE * max(camera.width for camera in cameras) / max(usual, 1e-9))
    figure = Figure(figsize=(3.4 * columns, 2.4 * rows + 3.0), layout="constrained")
    FigureCanvasAgg(figure)
    parts = figure.add_gridspec(2, 1, height_ratios=(2.4 * rows, 2.6))
    above, below = (figure.add_subfigure(parts[k]) for k in (0, 1))
    panels = above.subplots(rows, columns, squeeze=False)
    for axes in panels.ravel():
        axes.set_axis_off()
    for camera, (row, column) in zip(cameras, cells, strict=True):
        _draw_vectors(panels[row, column], camera, found.residuals[camera.id], times)
    left, right = below.subplots(1, 2)
    _draw_spread(left, [c.id for c in cameras], [found.residuals[c.id] for c in cameras])
    _draw_scatter(right, np.concatenate([found.residuals[c.id][:, 2:] for c in cameras]), usual)
    above.suptitle(f"residuals x {times:g}: {found.report['summary']}", fontsize=9)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    write_durably(path, buffer.getvalue())


def _grid(ids: list[str]) -> tuple[int, int, list[tuple[int, int]]]:
    """Return the rows, the columns and each camera's cell: as camRC names it, or one after another."""
    named = [GRID_ID.fullmatch(camera_id) for camera_id in ids]
    if all(named):
        cells = [(int(match[1]), int(match[2])) for match in named if match]
    else:
        columns = math.ceil(math.sqrt(len(ids)))
        cells = [divmod(number, columns) for number in range(len(ids))]
    return 1 + max(row for row, _ in cells), 1 + max(column for _, column in cells), cells


def _draw_vectors(axes: Axes, camera: Camera, rows: Floats, times: float) -> None:
    axes.set_axis_on()
    shown = rows[:: max(1, math.ceil(len(rows) / MOST_ARROWS))]
    x, y, dx, dy = shown.T
    axes.quiver(
        x, y, times * dx, times * dy, angles="xy", scale_units="xy", scale=1, color=COLOUR, width=0.004, headwidth=3
    )
    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal")
    axes.tick_params(labelsize=8)
    axes.set_title(f"{camera.id}: {_rms(rows):.4f} px, {len(rows)} points", fontsize=8)


def _draw_spread(axes: Axes, ids: list[str], residuals: list[Floats]) -> None:
    """Draw the quartiles and the usual range of each camera's residual lengths."""
    lengths = [np.linalg.norm(rows[:, 2:], axis=1) if len(rows) else np.zeros(1) for rows in residuals]
    axes.boxplot(lengths, tick_labels=ids, whis=(5, 95), showfliers=False)
    axes.plot(range(1, len(ids) + 1), [_rms(rows) for rows in residuals], "o", color=COLOUR, label="root mean square")
    axes.set(ylabel="residual / px", ylim=(0, None))
    axes.tick_params(labelsize=8)
    axes.grid(True, axis="y", alpha=0.3)
    axes.legend(fontsize=8)


def _draw_scatter(axes: Axes, apart: Floats, usual: float) -> None:
    """Draw all residuals about their middle."""
    axes.plot(apart[:, 0], apart[:, 1], ".", markersize=2, alpha=0.4, color=COLOUR)
    limit = 2 * max(usual, 1e-9)
    labels = {"xlabel": "dx / px, all cameras", "ylabel": "dy / px"}
    axes.set(xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal", **labels)
    axes.tick_params(labelsize=8)
    axes.grid(True, alpha=0.3)


def _rms(rows: Floats) -> float:
    return float(np.sqrt((rows[:, 2:] ** 2).sum(axis=1).mean())) if len(rows) else 0.0


def _round(number: float) -> float:
    """Round a number down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(number))
    return power * max(digit for digit in (1, 2, 5) if digit <= number / power * (1 + 1e-9))
