"""Error against run time, as JSON rows and a picture."""

import io
import textwrap
from collections.abc import Sequence

from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

WIDE_IN, NARROW_IN = (7.0, 4.2), (3.4, 3.2)  # sizes of the picture for a screen, and for a telephone
WIDE_DPI, NARROW_DPI = 110, 220
ALONG = {"psnr_db": "whole picture", "dynamic_psnr_db": "movers"}  # scores of a span and their names
LABELS = {"psnr_db": "PSNR / dB", "counts.rmse": "count error / spikes"}


def curve_png(
    rows: Sequence[dict], metric: str, floors: dict[str, float], caption: str, *, narrow: bool = False
) -> bytes:
    """Plot `metric` of the rows against their seconds (log) as PNG, with a dashed line for each floor."""
    data = io.BytesIO()
    figure = curve_figure(rows, metric, floors, caption, narrow=narrow)
    figure.savefig(data, format="png", dpi=NARROW_DPI if narrow else WIDE_DPI)
    return data.getvalue()


def curve_figure(
    rows: Sequence[dict], metric: str, floors: dict[str, float], caption: str, *, narrow: bool = False
) -> Figure:
    """Return the plot; a `narrow` one fills a telephone's width, with text that is read there without a glass."""
    figure = Figure(figsize=NARROW_IN if narrow else WIDE_IN, layout="constrained")
    axes = figure.add_subplot()
    axes.plot([r["seconds"] for r in rows], [r[metric] for r in rows], "o-", label="reconstruction", color="#1f5fa8")
    for (name, value), colour in zip(floors.items(), ("#888888", "#c26a1b"), strict=False):
        axes.axhline(value, linestyle="--", color=colour, label=name.replace("_", " "))
    axes.set_xscale("log")
    for axis_formatter in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        axis_formatter(LogFormatter(minor_thresholds=(10, 1)))
    since = "wall seconds since the start"
    axes.set_xlabel(since if narrow else f"{since}, images and initialisation included")
    axes.set_ylabel(LABELS[metric])
    axes.set_title(textwrap.fill(caption, 44) if narrow else caption, fontsize=9)
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(fontsize=9 if narrow else None)
    return figure


def along_png(spans: Sequence[dict]) -> bytes:
    """Plot the PSNR of spans, rows of `metrics.json`, along the recording as PNG; empty where none was scored."""
    scored = [span for span in spans if "psnr_db" in span]
    if not scored:
        return b""
    figure, data = Figure(figsize=WIDE_IN, layout="constrained"), io.BytesIO()
    axes = figure.add_subplot()
    for score, name in ALONG.items():
        rows = [span for span in scored if score in span]
        axes.plot(
            [(row["first_tick"] + row["last_tick"]) / 2 for row in rows], [row[score] for row in rows], "o-", label=name
        )
    axes.set_xlabel("plane")
    axes.set_ylabel("PSNR / dB")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(data, format="png", dpi=WIDE_DPI)
    return data.getvalue()
