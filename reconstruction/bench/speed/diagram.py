"""Draws the speed bench: error against run time, ends of runs of the old and the new revision, a panel a scene."""

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from reconstruction.bench.figures import (
    COLOURS,
    SIZE,
    caption,
    db_scale,
    log_axes,
    new_figure,
    relative_error,
    write_figure,
)
from reconstruction.bench.speed.run import NEW, OLD
from reconstruction.bench.speed.summary import clips_of, ends

COLUMNS = 3  # panels in a row at most
PANEL = (4.6, 3.7)  # inches
LINES = (("psnr_db", "whole", "-", "o"), ("dynamic_psnr_db", "movers", ":", "^"))
COLOUR = {OLD: COLOURS[1], NEW: COLOURS[0]}
ENDS = "A mark is the end of a run with its budget, in a process of its own; both revisions in turns."


def plot_speed(path: Path, document: dict) -> None:
    """Draw the error at the ends of both revisions' runs against run time; a document without runs has no picture."""
    rows = document["rows"]
    clips = clips_of(rows)
    if not clips:
        return
    across = min(COLUMNS, len(clips))
    down = math.ceil(len(clips) / across)
    figure = new_figure(
        "Error against run time: ends of runs", (max(SIZE[0], PANEL[0] * across), 0.8 + PANEL[1] * down)
    )
    panels = figure.subplots(down, across, squeeze=False).flat
    for number, (axes, clip) in enumerate(zip(panels, clips, strict=False)):
        _panel(axes, ends(rows, clip))
        axes.set_title(clip, fontsize=10)
        name = "RMS error of the held-out view / white  (PSNR)" if number % across == 0 else ""
        log_axes(axes, "wall seconds from start to last checkpoint", name)
        db_scale(axes)
        budgets = sorted({row["budget_s"] for row in ends(rows, clip)})
        axes.set_xticks(budgets, [f"{budget:g}" for budget in budgets])
        if not number:
            axes.legend(fontsize=8, frameon=False)
    for axes in list(figure.axes)[len(clips) :]:
        axes.set_visible(False)
    old = sorted({row["revision"] for row in rows if row["which"] == OLD})
    more = f"{ENDS} old: {', '.join(old)}." if old else ENDS
    write_figure(path, figure, caption(document, [row for row in rows if "clip" in row], more))


def _panel(axes: Axes, rows: list[dict]) -> None:
    """Draw a line for each revision and score."""
    for which in (OLD, NEW):
        for score, what, style, mark in LINES:
            own = sorted((r["seconds"], r[score]) for r in rows if r["which"] == which and score in r)
            seconds, levels = np.array(own).reshape(-1, 2).T
            look = {"linestyle": style, "marker": mark, "color": COLOUR[which], "linewidth": 1.6, "markersize": 5}
            axes.plot(seconds, relative_error(levels), label=f"{which}, {what}" if own else None, **look)
