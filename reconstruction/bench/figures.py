"""Gives every bench's figures one style: logarithmic axes, a scale of dB, and a caption that names the machine.

The error behind a PSNR is the root mean square error over the data range, 10^(-PSNR / 20). Its axis is logarithmic,
carries dB at its ticks, and has the better end below.
"""

import io
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator
from numpy.typing import ArrayLike, NDArray

from acquisition.bench_document import machines_of, revisions_of
from acquisition.durable import write_durably

SIZE = (8.6, 5.2)  # inches
DPI = 110
CAPTION_CHARACTERS = 150
GREY = "#666"
COLOURS = (
    *("#0b5fa5", "#d1495b", "#2e8b57", "#e08e0b", "#7b4ea3", "#00838f"),
    *("#8d5a2b", "#c2579e", "#5f6b73", "#9aa500", "#111111", "#e39b8b"),
)
MARKS = "os^Dvp<>hXP*"
TICKS = (  # ratio of an axis's ends up to which it has these ticks in a decade
    (30, (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)),
    (1000, (1.0, 2.0, 5.0)),
    (float("inf"), (1.0,)),
)
DB_STEPS = (0.25, 0.5, 1, 2, 5, 10)
MOST_DB_TICKS = 11


def relative_error(psnr_db: ArrayLike) -> NDArray[np.float64]:
    """Return the root mean square error over the data range."""
    return 10 ** (-np.asarray(psnr_db, dtype=np.float64) / 20)


def new_figure(title: str, size: tuple[float, float] = SIZE) -> Figure:
    """Return an empty figure of `size` in inches with a title."""
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11, fontweight="bold")
    return figure


def name_axes(axes: Axes, x: str, y: str) -> None:
    """Name the axes and draw their grid."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(True, color="#ddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def log_axes(axes: Axes, x: str, y: str, *, log_x: bool = True) -> None:
    """Name the axes and make them logarithmic, with plain numbers at round places."""
    name_axes(axes, x, y)
    axes.set_yscale("log")
    if log_x:
        axes.set_xscale("log")
    for axis in (axes.xaxis, axes.yaxis) if log_x else (axes.yaxis,):
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(subs=next(ticks for most, ticks in TICKS if high <= most * low)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def db_scale(axes: Axes) -> None:
    """Put the ticks of an error axis at round dB, and name them so."""
    low, high = sorted(-20 * np.log10(np.asarray(axes.get_ylim())))
    step = next((s for s in DB_STEPS if (high - low) / s <= MOST_DB_TICKS), DB_STEPS[-1])
    ticks = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    axes.yaxis.set_major_locator(FixedLocator(relative_error(ticks).tolist()))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda error, _: f"{error:.3f}  ({0 - 20 * np.log10(error):g} dB)"))


def band(axes: Axes, x: ArrayLike, levels: ArrayLike, number: int, label: str) -> None:
    """Draw the median over recordings of `levels` [R, P] at each place of `x` [P], and a band from lowest to highest.

    `number` picks the colour and the mark.
    """
    values = np.atleast_2d(np.asarray(levels, dtype=np.float64))
    colour, mark = COLOURS[number % len(COLOURS)], MARKS[number % len(MARKS)]
    axes.plot(x, np.median(values, axis=0), marker=mark, color=colour, linewidth=1.6, markersize=4.5, label=label)
    if len(values) > 1:
        axes.fill_between(np.asarray(x), values.min(axis=0), values.max(axis=0), color=colour, alpha=0.12, lw=0)


def errors(rows: Sequence[dict]) -> list[float]:
    """Return the relative errors behind the PSNR of rows."""
    return relative_error([row["psnr_db"] for row in rows]).tolist()


def bars(axes: Axes, groups: Mapping[float, Sequence], number: int, label: str = "", style: str = "-") -> None:
    """Draw the median of the group at each place, joined, and a bar from the group's lowest to its highest value."""
    if not groups:
        return
    x, middle = list(groups), np.array([np.median(group) for group in groups.values()])
    reach = np.abs(np.array([[min(group), max(group)] for group in groups.values()]).T - middle)
    colour, mark = COLOURS[number % len(COLOURS)], MARKS[number % len(MARKS)]
    axes.plot(x, middle, marker=mark, color=colour, linewidth=1.6, markersize=5.5, label=label or None, ls=style)
    axes.errorbar(x, middle, reach, fmt="none", ecolor=colour, elinewidth=0.9, capsize=2)


@contextmanager
def chart(path: Path, title: str, names: tuple[str, str], below: str, *, log_x: bool = True) -> Iterator[Axes]:
    """Yield the axes of a picture with a legend beside them, and write it; `names` are those of the two axes."""
    figure = new_figure(title)
    axes = figure.subplots()
    yield axes
    log_axes(axes, *names, log_x=log_x)
    if "PSNR" in names[1]:
        db_scale(axes)
    axes.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    write_figure(path, figure, below)


def caption(document: dict, rows: Sequence[dict], *more: str) -> str:
    """Return the lines below a figure: machines, revisions and recordings of `rows`, then `more`."""
    scenes = {r["scene"] for r in rows if "seed" in r}
    seeds = {scene: sorted({str(r["seed"]) for r in rows if r.get("scene") == scene}) for scene in scenes}
    clips = ", ".join(f"{scene} {' '.join(numbers)}" for scene, numbers in sorted(seeds.items()))
    made = f"{machines_of(document, rows)}; {revisions_of(document, rows)}"
    lines = (f"{made}{clips and '; '}{clips}.", *more)
    return "\n".join(part for text in lines for part in textwrap.wrap(text, CAPTION_CHARACTERS))


def write_figure(path: Path, figure: Figure, below: str) -> None:
    """Write a PNG with the text `below` it."""
    figure.supxlabel(below, fontsize=7, color=GREY)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    write_durably(path, buffer.getvalue())
