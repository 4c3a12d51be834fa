"""Draws the training bench: error against run time, by snapshots of its longest runs and the ends of all.

A snapshot is on its way to the end that its run was planned for, so ends are compared with ends.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from reconstruction.bench.figures import COLOURS, band, caption, chart, relative_error
from reconstruction.bench.paper.diagrams import ERROR, SECONDS
from reconstruction.bench.paper.summary import lengths

BAND = "Line: median; band: lowest to highest of recordings. Rings: ends of runs."
SCHEDULE = "A curve is one run's snapshots on its way to the end it was planned for; compare ends with ends."
STOPPED = "The clock stands while a result is scored; a run that warms up came before."


def plot_training(path: Path, document: dict) -> None:
    """Draw every method's error against run time; documents of older revisions name the budget, not the effort."""
    rows = [{"effort": f"{row['budget_s']:g}", **row} for row in document["rows"]]
    below = caption(document, rows, f"{BAND} {SCHEDULE} {STOPPED}")
    with chart(path, "Whole reconstructions: error against run time", (SECONDS, ERROR), below) as axes:
        for number, name in enumerate(dict.fromkeys(row["method"] for row in rows)):
            own = [row for row in rows if row["method"] == name]
            band(axes, *curve(own), number, name)
            _ends(axes, own, number)


def curve(rows: Sequence[dict]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return seconds [P] and errors [R, P] of the snapshots of a method's widest runs."""
    runs = [row["curve"] for row in _widest(rows)]
    count = min(map(len, runs))  # a run that ended early has fewer; all have the last ones
    points = [own[-count:] for own in runs]
    seconds, levels = (np.array([[point[key] for point in own] for own in points]) for key in ("seconds", "psnr_db"))
    return np.median(seconds, axis=0), relative_error(levels)


def _widest(rows: Sequence[dict]) -> list[dict]:
    """Return the runs of the length that most scenes were run at, the longest one of several."""
    return max(lengths(rows), key=lambda own: (len({r["scene"] for r in own}), max(r["seconds"] for r in own)))


def _ends(axes: Axes, rows: Sequence[dict], number: int) -> None:
    """Ring the end of each length of runs, at the median over recordings."""
    ring = {"mfc": "none", "mec": COLOURS[number % len(COLOURS)], "markersize": 9}
    for own in lengths(rows):
        seconds, level = (np.median([row[key] for row in own]) for key in ("seconds", "psnr_db"))
        axes.plot(seconds, relative_error(level), "o", **ring)
