"""Work-precision diagrams out of the documents: one question a picture, error against what it costs."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.axes import (
    COLOURS,
    caption,
    db_scale,
    line,
    log_axes,
    marks,
    new_figure,
    relative_error,
    write_figure,
)
from reconstruction.bench.paper.other_diagrams import image_methods, pose_methods
from reconstruction.bench.paper.summary import RIVALS, TARGETS_DB, lengths, ordinary, times_to, widest
from reconstruction.bench.score_run import STAGES
from reconstruction.methods.ours import BASES

ERROR = "RMS error of the held-out view / white  (PSNR)"
SECONDS = "wall seconds, from recording to result"
STOPPED = "The clock stands while a result is scored; a run that warms up came before."
BAND = "Line: median; band: lowest to highest of recordings."
DEPTH = ("Depth of the held-out view", "Abs Rel")
SHOWN = (m.AUTO.name, *RIVALS, m.FOUND.name, m.CLEAN.name, m.MSDI["spss"].name)
DEEP = (m.AUTO.name, *RIVALS, *(method.name for method in m.SPK2IMGNET.values()))
BAR = "Mark: median; bar: lowest to highest of recordings."
SWEEPS = {  # a number in a method's name: its axis, and what it is where the name has none
    "views": ("training views", len(m.VIEWS)),
    "gaussians": ("most Gaussians", BASES.gaussians),
    "drop": ("planes a second", m.RATE_HZ),
    "reintegrate": ("planes a second", m.RATE_HZ),
}
HOW = {"drop": "planes dropped", "reintegrate": "planes re-integrated"}


def write_diagrams(out: Path, document: dict, others: Mapping[str, dict | None]) -> list[Path]:
    """Write each diagram that has something to show as `paper-QUESTION.png`; returns what was written."""
    document = document | {"rows": ordinary(document["rows"])}
    drawn: dict[str, Callable[[Path], bool]] = {
        "novel-view": lambda path: against_time(path, document, SHOWN, "psnr_db", ("Novel view", ERROR)),
        "depth": lambda path: against_time(path, document, DEEP, "abs_rel", DEPTH),
        "time-to": lambda path: time_to(path, document),
        "stages": lambda path: stages(path, document),
        "gaussians": lambda path: sweep(path, document, ("gaussians",), "Error against the number of Gaussians"),
        "views": lambda path: sweep(path, document, ("views",), "Error against training views"),
        "rates": lambda path: sweep(path, document, ("drop", "reintegrate"), "Error against plane rate"),
    }
    images, poses = others.get("images"), others.get("poses")
    if images:
        drawn["images"] = lambda path: image_methods(path, images)
    if poses:
        drawn["poses"] = lambda path: pose_methods(path, poses, "rotation_deg", "rotation error / degrees", "Poses")
        drawn["points"] = lambda path: pose_methods(path, poses, "points_abs_rel", "Abs Rel of the points", "Points")
    paths = {name: out / f"paper-{name}.png" for name in drawn}
    return [paths[name] for name, draw in drawn.items() if draw(paths[name])]


def curves(rows: Sequence[dict], method: str, metric: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Seconds [P] and errors [R, P] of a method's `widest` runs, by snapshot; None where none has snapshots of it."""
    own = [r for r in rows if r["method"] == method and all(metric in p for p in r["curve"])]
    if not own:
        return None
    runs = [r["curve"] for r in widest(own)]
    count = min(len(points) for points in runs)  # an early end has fewer; the last ones are those of the end
    seconds = np.array([[p["seconds"] for p in points[-count:]] for points in runs])
    return np.median(seconds, axis=0), _error(metric, [[p[metric] for p in points[-count:]] for points in runs])


def against_time(path: Path, document: dict, known: Sequence[str], metric: str, names: tuple[str, str]) -> bool:
    """Error against time of training: snapshots of each method's `widest` runs, and the end of each length of them."""
    rows = [r for r in document["rows"] if r["method"] in known and metric in r]
    if not rows:
        return False
    title, y = names
    figure, axes = new_figure(f"{title}: error against run time")
    for number, name in enumerate(known):
        found = curves(rows, name, metric)
        if found is not None:
            line(axes, *found, number, name)
        _ends(axes, [r for r in rows if r["method"] == name], metric, number)
    log_axes(axes, SECONDS, y)
    if metric == "psnr_db":
        db_scale(axes)
    write_figure(path, figure, caption(document, rows, f"{BAND} Rings: ends of runs. {STOPPED}"))
    return True


def _error(metric: str, values: ArrayLike) -> np.ndarray:
    return relative_error(values) if metric == "psnr_db" else np.asarray(values, dtype=np.float64)


def _ends(axes: Axes, rows: Sequence[dict], metric: str, number: int) -> None:
    """The end of each length of runs, median over recordings."""
    ring = {"mfc": "none", "mec": COLOURS[number % len(COLOURS)], "markersize": 9}
    for own in lengths(rows):
        axes.plot(_seconds(own), _error(metric, np.median([r[metric] for r in own])), "o", **ring)


def time_to(path: Path, document: dict) -> bool:
    """Seconds to each level, of the methods and levels that every recording reached."""
    figure, axes = new_figure("Run time to a level of the held-out view")
    rows = [r for r in document["rows"] if r["method"] in SHOWN]
    drawn = 0
    for number, name in enumerate(SHOWN):
        reached = {target: times_to(rows, name, target) for target in TARGETS_DB}
        whole = {target: [t for t in times if t] for target, times in reached.items() if times and all(times)}
        if whole:
            marks(axes, list(whole), list(whole.values()), number, name)
            drawn += 1
    if not drawn:
        return False
    log_axes(axes, "PSNR of the held-out view / dB", SECONDS, log_x=False)
    axes.set_xticks(TARGETS_DB)
    write_figure(path, figure, caption(document, rows, f"{BAR} A level that a recording missed has no mark. {STOPPED}"))
    return True


def stages(path: Path, document: dict) -> bool:
    """Seconds of each stage, mean over recordings, at the length that most methods were run at."""
    shown = lengths([r for r in document["rows"] if r["method"] in SHOWN])
    if not shown:
        return False
    rows = max(shown, key=lambda own: len({r["method"] for r in own}))
    runs = {name: [r for r in rows if r["method"] == name] for name in SHOWN}
    runs = {name: own for name, own in runs.items() if own}
    figure, axes = new_figure(f"Where the seconds go (@{rows[0]['effort']})")
    methods, left = list(runs), np.zeros(len(runs))
    for number, stage in enumerate(STAGES):
        width = np.array([np.mean([r[f"seconds.{stage}"] for r in own]) for own in runs.values()])
        axes.barh(methods, width, left=left, color=COLOURS[number], label=stage, height=0.65)
        left += width
    axes.invert_yaxis()
    axes.set_xlabel("wall seconds, mean over recordings")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=8, frameon=False, ncols=len(STAGES), loc="lower center", bbox_to_anchor=(0.5, 1.0))
    write_figure(path, figure, caption(document, rows))
    return True


def sweep(path: Path, document: dict, kinds: Sequence[str], title: str) -> bool:
    """Error against a number in the methods' names, such as `auto.views5`."""
    drawn = []
    for kind in kinds:
        named, bare = re.compile(rf"(.+)\.{kind}(\d+)"), SWEEPS[kind][1]
        places: dict[str, dict[int, list[dict]]] = {}
        for row in document["rows"]:
            match = named.fullmatch(row["method"])
            if match:
                places.setdefault(match[1], {}).setdefault(int(match[2]), []).append(row)
        for method, found in places.items():
            swept = [r for rows in found.values() for r in rows]
            whole = [r for r in document["rows"] if r["method"] == method and _alike(r, swept)]
            drawn.append(
                (f"{method}, {HOW[kind]}" if kind in HOW else method, found | {bare: whole} if whole else found)
            )
    if not drawn:
        return False
    figure, axes = new_figure(title)
    for number, (name, found) in enumerate(drawn):
        x = sorted(found)
        marks(axes, x, [relative_error([r["psnr_db"] for r in found[k]]).tolist() for k in x], number, name)
    log_axes(axes, SWEEPS[kinds[0]][0], ERROR)
    db_scale(axes)
    rows = [r for _, found in drawn for some in found.values() for r in some]
    write_figure(path, figure, caption(document, rows, BAR))
    return True


def _alike(row: dict, swept: Sequence[dict]) -> bool:
    """Whether a row is of a recording and a length that the swept ones are of."""
    return any(all(row[key] == r[key] for key in ("scene", "seed", "effort")) for r in swept)


def _seconds(rows: Sequence[dict]) -> float:
    return float(np.median([r["seconds"] for r in rows]))
