"""What all work-precision diagrams share: logarithmic axes, a scale of dB, and a caption that names the machine.

The error behind a PSNR is the root mean square error over the data range, 10^(-PSNR / 20): its axis is logarithmic and
carries dB at its ticks, better below.
"""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator
from numpy.typing import ArrayLike, NDArray

from acquisition.durable import write_durably

SIZE = (8.6, 5.2)
DPI = 130
CAPTION_CHARACTERS = 150
GREY = "#666"
COLOURS = (
    *("#0b5fa5", "#d1495b", "#2e8b57", "#e08e0b", "#7b4ea3", "#00838f"),
    *("#8d5a2b", "#c2579e", "#5f6b73", "#9aa500", "#111111", "#e39b8b"),
)
MARKS = "os^Dvp<>hXP*"
FEW_TICKS, MANY_TICKS = (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
WIDE = 30  # an axis that has few ticks a decade
DB_STEPS = (0.25, 0.5, 1, 2, 5, 10)
MOST_DB_TICKS = 11


def relative_error(psnr_db: ArrayLike) -> NDArray[np.float64]:
    """The root mean square error over the data range."""
    return 10 ** (-np.asarray(psnr_db, dtype=np.float64) / 20)


def new_figure(title: str) -> tuple[Figure, Axes]:
    """A figure with a title, and its axes."""
    figure = Figure(figsize=SIZE, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11, fontweight="bold")
    return figure, figure.subplots()


def log_axes(axes: Axes, x: str, y: str, *, log_x: bool = True) -> None:
    """Name the axes and make them logarithmic, with plain numbers at round places; a legend of what is drawn."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_yscale("log")
    if log_x:
        axes.set_xscale("log")
    for axis in (axes.xaxis, axes.yaxis) if log_x else (axes.yaxis,):
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(subs=FEW_TICKS if high > WIDE * low else MANY_TICKS))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.grid(True, color="#ddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def db_scale(axes: Axes) -> None:
    """Ticks of the error axis at round dB, named so."""
    low, high = sorted(-20 * np.log10(np.asarray(axes.get_ylim())))
    step = next((s for s in DB_STEPS if (high - low) / s <= MOST_DB_TICKS), DB_STEPS[-1])
    ticks = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    axes.yaxis.set_major_locator(FixedLocator(relative_error(ticks).tolist()))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda error, _: f"{error:.3f}  ({0 - 20 * np.log10(error):g} dB)"))


def line(axes: Axes, x: ArrayLike, levels: ArrayLike, number: int, label: str) -> None:
    """A method's median over recordings [R, P] at each place x [P], and from its lowest to its highest."""
    values = np.atleast_2d(np.asarray(levels, dtype=np.float64))
    colour, mark = COLOURS[number % len(COLOURS)], MARKS[number % len(MARKS)]
    axes.plot(x, np.median(values, axis=0), marker=mark, color=colour, linewidth=1.6, markersize=4.5, label=label)
    if len(values) > 1:
        axes.fill_between(np.asarray(x), values.min(axis=0), values.max(axis=0), color=colour, alpha=0.12, lw=0)


def marks(axes: Axes, x: Sequence[float], groups: Sequence[Sequence[float]], number: int, label: str) -> None:
    """A method's median at each place, joined, with a bar from the lowest to the highest of its group."""
    middle = np.array([np.median(group) for group in groups])
    reach = np.abs(np.array([[min(group), max(group)] for group in groups]).T - middle)
    colour, mark = COLOURS[number % len(COLOURS)], MARKS[number % len(MARKS)]
    axes.plot(x, middle, marker=mark, color=colour, linewidth=1.6, markersize=5.5, label=label)
    axes.errorbar(x, middle, reach, fmt="none", ecolor=colour, elinewidth=0.9, capsize=2)


def caption(document: dict, rows: Sequence[dict], *more: str) -> str:
    """Machine, threads, recordings and code behind a picture."""
    machines = {(r["processor"], r["threads"]) for r in rows if "processor" in r}
    machines = machines or {(document["device"]["processor"], document["device"]["threads"])}
    on = "; ".join(f"{processor}, {threads} threads" for processor, threads in sorted(machines))
    seeds = {r["scene"]: sorted({str(s["seed"]) for s in rows if s["scene"] == r["scene"]}) for r in rows}
    clips = ", ".join(f"{scene} {' '.join(numbers)}" for scene, numbers in sorted(seeds.items()))
    lines = (f"{on}; revision {document['revision']}; {clips}.", *more)
    return "\n".join(part for text in lines for part in textwrap.wrap(text, CAPTION_CHARACTERS))


def write_figure(path: Path, figure: Figure, caption: str) -> None:
    """Write a PNG with its caption below."""
    figure.supxlabel(caption, fontsize=7, color=GREY)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    write_durably(path, buffer.getvalue())
