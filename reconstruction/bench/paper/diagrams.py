"""Draws the documents of the paper and training benches: one question a picture, error against what it costs."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

from reconstruction.bench.figures import (
    COLOURS,
    band,
    bars,
    caption,
    chart,
    errors,
    name_axes,
    new_figure,
    relative_error,
    write_figure,
)
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.summary import RIVALS, TARGETS_DB, lengths, ordinary, times_to, widest
from reconstruction.bench.score_run import STAGES
from reconstruction.methods.ours import BASES

ERROR = "RMS error of the held-out view / white  (PSNR)"
SECONDS = "wall seconds, from recording to result"
STOPPED = "The clock stands while a result is scored; a run that warms up came before."
BAND = "Line: median; band: lowest to highest of recordings. Rings: ends of runs."
SCHEDULE = "A curve is one run's snapshots on its way to the end it was planned for; compare ends with ends."
BARS = "Mark: median; bar: lowest to highest of recordings."
DEPTH = ("Depth of the held-out view", "Abs Rel")
SHOWN = (m.AUTO.name, *RIVALS, m.FOUND.name, m.CLEAN.name, m.MSDI["image-variation"].name)
DEEP = (m.AUTO.name, *RIVALS, *(method.name for method in m.SPK2IMGNET.values()))
SWEEPS = {  # a number in a method's name: its axis, and its value where the name has none
    "views": ("training views", len(m.VIEWS)),
    "gaussians": ("most Gaussians", BASES.gaussians),
    "drop": ("planes a second", m.RATE_HZ),
    "reintegrate": ("planes a second", m.RATE_HZ),
}
HOW = {"drop": "planes dropped", "reintegrate": "planes re-integrated"}


def write_diagrams(out: Path, document: dict) -> list[Path]:
    """Write each diagram that has something to show as `paper-QUESTION.png`, and return what was written."""
    document = document | {"rows": ordinary(document["rows"])}
    drawn: dict[str, Callable[[Path], bool]] = {
        "novel-view": lambda path: against_time(path, document, SHOWN, "psnr_db", ("Novel view", ERROR)),
        "depth": lambda path: against_time(path, document, DEEP, "abs_rel", DEPTH),
        "time-to": lambda path: _time_to(path, document),
        "stages": lambda path: _stages(path, document),
        "gaussians": lambda path: _sweep(path, document, ("gaussians",), "Error against the number of Gaussians"),
        "views": lambda path: _sweep(path, document, ("views",), "Error against training views"),
        "rates": lambda path: _sweep(path, document, ("drop", "reintegrate"), "Error against plane rate"),
    }
    paths = {name: out / f"paper-{name}.png" for name in drawn}
    return [paths[name] for name, draw in drawn.items() if draw(paths[name])]


def curves(rows: Sequence[dict], method: str, metric: str) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return seconds [P] and errors [R, P] of the snapshots of a method's `widest` runs; None where none has any."""
    own = [r for r in rows if r["method"] == method and all(metric in p for p in r["curve"])]
    if not own:
        return None
    runs = [r["curve"] for r in widest(own)]
    count = min(len(points) for points in runs)  # a run that ended early has fewer; all have the last ones
    seconds = np.array([[p["seconds"] for p in points[-count:]] for points in runs])
    return np.median(seconds, axis=0), _error(metric, [[p[metric] for p in points[-count:]] for points in runs])


def against_time(path: Path, document: dict, known: Sequence[str], metric: str, names: tuple[str, str]) -> bool:
    """Draw error against run time: snapshots of each method's `widest` runs, and the end of each length of them.

    `names` are the title and the name of the error's axis. Returns whether there was anything to draw.
    """
    rows = [r for r in document["rows"] if r["method"] in known and metric in r]
    if not rows:
        return False
    title, y = names
    below = caption(document, rows, f"{BAND} {SCHEDULE} {STOPPED}")
    with chart(path, f"{title}: error against run time", (SECONDS, y), below) as axes:
        for number, name in enumerate(known):
            found = curves(rows, name, metric)
            if found is not None:
                band(axes, *found, number, name)
            _ends(axes, [r for r in rows if r["method"] == name], metric, number)
    return True


def _error(metric: str, values: ArrayLike) -> NDArray[np.float64]:
    return relative_error(values) if metric == "psnr_db" else np.asarray(values, dtype=np.float64)


def _ends(axes: Axes, rows: Sequence[dict], metric: str, number: int) -> None:
    """Ring the end of each length of runs, at the median over recordings."""
    ring = {"mfc": "none", "mec": COLOURS[number % len(COLOURS)], "markersize": 9}
    for own in lengths(rows):
        seconds = np.median([r["seconds"] for r in own])
        axes.plot(seconds, _error(metric, np.median([r[metric] for r in own])), "o", **ring)


def _time_to(path: Path, document: dict) -> bool:
    """Draw the seconds to each level, of the methods and levels that every recording reached."""
    rows = [r for r in document["rows"] if r["method"] in SHOWN]
    places: dict[str, dict[float, list[float]]] = {}
    for name in SHOWN:
        for target in TARGETS_DB:
            times = times_to(rows, name, target)
            if times and None not in times:
                places.setdefault(name, {})[target] = [t for t in times if t is not None]
    if not places:
        return False
    below = caption(document, rows, f"{BARS} A level that a recording missed has no mark. {STOPPED}")
    names = ("PSNR of the held-out view / dB", SECONDS)
    with chart(path, "Run time to a level of the held-out view", names, below, log_x=False) as axes:
        for name, reached in places.items():
            bars(axes, reached, SHOWN.index(name), name)
        axes.set_xticks(TARGETS_DB)
    return True


def _stages(path: Path, document: dict) -> bool:
    """Draw the seconds of each stage, means over recordings, at the length that most methods were run at."""
    shown = lengths([r for r in document["rows"] if r["method"] in SHOWN])
    if not shown:
        return False
    rows = max(shown, key=lambda own: len({r["method"] for r in own}))
    methods = [name for name in SHOWN if any(r["method"] == name for r in rows)]
    figure = new_figure(f"Where the seconds go (@{rows[0]['effort']})")
    axes, left = figure.subplots(), np.zeros(len(methods))
    for number, stage in enumerate(STAGES):
        width = np.array([np.mean([r[f"seconds.{stage}"] for r in rows if r["method"] == name]) for name in methods])
        axes.barh(methods, width, left=left, color=COLOURS[number], label=stage, height=0.65)
        left += width
    name_axes(axes, "wall seconds, mean over recordings", "")
    axes.invert_yaxis()
    axes.legend(fontsize=8, frameon=False, ncols=len(STAGES), loc="lower center", bbox_to_anchor=(0.5, 1.0))
    write_figure(path, figure, caption(document, rows))
    return True


def _sweep(path: Path, document: dict, kinds: Sequence[str], title: str) -> bool:
    """Draw error against a number in the methods' names, such as `auto.views5`."""
    drawn = [found for kind in kinds for found in _swept(document["rows"], kind)]
    if not drawn:
        return False
    rows = [r for _, found in drawn for some in found.values() for r in some]
    with chart(path, title, (SWEEPS[kinds[0]][0], ERROR), caption(document, rows, BARS)) as axes:
        for number, (name, found) in enumerate(drawn):
            bars(axes, {place: errors(found[place]) for place in sorted(found)}, number, name)
    return True


def _swept(rows: Sequence[dict], kind: str) -> list[tuple[str, dict[int, list[dict]]]]:
    """Return, for each method that was swept, its rows by number; the method as it is stands at its usual number."""
    named = re.compile(rf"(.+)\.{kind}(\d+)")
    places: dict[str, dict[int, list[dict]]] = {}
    for row in rows:
        match = named.fullmatch(row["method"])
        if match:
            places.setdefault(match[1], {}).setdefault(int(match[2]), []).append(row)
    drawn = []
    for method, found in places.items():
        alike = {(r["scene"], r["seed"], r["effort"]) for some in found.values() for r in some}
        whole = [r for r in rows if r["method"] == method and (r["scene"], r["seed"], r["effort"]) in alike]
        name = f"{method}, {HOW[kind]}" if kind in HOW else method
        drawn.append((name, found | ({SWEEPS[kind][1]: whole} if whole else {})))
    return drawn
