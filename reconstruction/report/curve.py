"""Error against run time, as JSON rows and a picture."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from acquisition.durable import made_aside

LABELS = {"psnr_db": "PSNR / dB", "counts.rmse": "count error / spikes"}


def draw_curve(path: Path, rows: Sequence[dict], metric: str, floors: dict[str, float], caption: str) -> None:
    """Plot `metric` of the rows against their seconds (log), with a dashed line for each floor."""
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([r["seconds"] for r in rows], [r[metric] for r in rows], "o-", label="reconstruction", color="#1f5fa8")
    for (name, value), colour in zip(floors.items(), ("#888888", "#c26a1b"), strict=False):
        axes.axhline(value, linestyle="--", color=colour, label=name.replace("_", " "))
    axes.set_xscale("log")
    for axis_formatter in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        axis_formatter(LogFormatter(minor_thresholds=(10, 1)))
    axes.set_xlabel("wall seconds since the start, images and initialisation included")
    axes.set_ylabel(LABELS[metric])
    axes.set_title(caption, fontsize=9)
    axes.grid(True, which="both", alpha=0.3)
    axes.legend()
    with made_aside(path) as aside:
        figure.savefig(aside, format="png", dpi=110)
