"""Draws the bench of rivals: error against run time, a panel for each set of lengths."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from reconstruction.bench.figures import SIZE, bars, caption, db_scale, errors, log_axes, new_figure, write_figure
from reconstruction.bench.paper.bench import lacks_runs
from reconstruction.bench.paper.diagrams import BARS, ERROR, SECONDS
from reconstruction.bench.paper.method import Effort
from reconstruction.bench.paper.methods import AUTO
from reconstruction.bench.paper.summary import lengths
from reconstruction.bench.rivals.bench import GROUPS, LABELS, LONG, SHORT, SHORTEST

PANELS = ((SHORTEST, SHORT), (SHORTEST, SHORT, LONG))
PANEL_WIDTH = 4.6  # inches
ENDS = "Every mark is the end of runs of one length."


def plot_rivals(path: Path, document: dict) -> None:
    """Draw a panel for each of PANELS, of the recordings that have its lengths; without any nothing is drawn."""
    panels = [(efforts, rows) for efforts in PANELS if (rows := _whole(document, efforts))]
    if not panels:
        return
    size = SIZE[0] + PANEL_WIDTH * (len(panels) - 1), SIZE[1]
    figure = new_figure("Ours and its rivals: error against run time", size)
    row = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (efforts, rows) in zip(row, panels, strict=True):
        _panel(axes, rows)
        log_axes(axes, SECONDS, ERROR if axes is row[0] else "")
        seconds = [effort.label for effort in efforts]
        axes.set_xticks([float(text) for text in seconds], seconds)
        axes.set_title(f"recordings run for {', '.join(seconds)} s: {len(set(map(_recording, rows)))}", fontsize=10)
    db_scale(row[0])
    row[-1].legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    write_figure(path, figure, caption(document, [run for _, rows in panels for run in rows], BARS, ENDS))


def _whole(document: dict, efforts: Sequence[Effort]) -> list[dict]:
    """Return the runs of these lengths on the recordings on which ours has all of them, of tables that lack no run."""
    whole = {
        scene
        for name, group in GROUPS.items()
        if efforts[-1] in group.lengths and not group.methods and not lacks_runs(document["omissions"], name)
        for scene in group.scenes
    }
    labels = {effort.label for effort in efforts}
    rows = [row for row in document["rows"] if row["scene"] in whole and row["effort"] in labels]
    ours = [row for row in rows if row["method"] == AUTO.name]
    known = set.intersection(*({_recording(row) for row in ours if row["effort"] == label} for label in labels))
    return [row for row in rows if _recording(row) in known]


def _panel(axes: Axes, rows: Sequence[dict]) -> None:
    """Draw a line for each method through the ends of its runs."""
    for number, (name, label) in enumerate(LABELS.items()):
        own = [row for row in rows if row["method"] == name]
        ends = {float(np.median([run["seconds"] for run in runs])): errors(runs) for runs in lengths(own)}
        bars(axes, dict(sorted(ends.items())), number, label)


def _recording(row: dict) -> tuple[str, int]:
    return row["scene"], row["seed"]
