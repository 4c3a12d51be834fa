"""Draws the documents of the stress catalogue and of all benches but the paper's, one picture each."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from reconstruction.bench.figures import (
    COLOURS,
    bars,
    caption,
    db_scale,
    errors,
    log_axes,
    name_axes,
    new_figure,
    write_figure,
)
from reconstruction.bench.long.page import plot_long
from reconstruction.bench.paper.diagrams import BARS
from reconstruction.bench.rivals.diagram import plot_rivals
from reconstruction.bench.speed.diagram import plot_speed
from reconstruction.bench.training.diagram import plot_training
from reconstruction.bench.uncertainty.page import plot_uncertainty

LEAST_S = 0.05  # the place of the rig as drawn, which takes no time
IMAGE_ERROR = "RMS error / white  (PSNR)"
SWEEPS = (("nominal", "error of the rig as drawn / degrees, cm, %"), ("views", "views"), ("planes", "planes recorded"))
LEFT_OUT = (
    ("cpu_s", "processor seconds", False),
    ("peak_mb", "peak memory / MB", False),
    ("psnr_db", "PSNR / dB", False),
    ("psnr_db", "PSNR at equal time / dB", True),
)
LINES = ("between", "beyond", "forward", "backward")
SEEN = (("psnr_db", "PSNR / dB"), ("abs_rel", "Abs Rel of the depth"), ("empty", "share of pixels left empty"))


def plot_images(path: Path, document: dict) -> None:
    """Draw the error of each method's images against run time, plane rate and light."""
    rows = [row for row in document["rows"] if row.get("part") == "scenes" and "psnr_db" in row]
    figure = new_figure("Spikes to images: error against run time, plane rate and light", (14, 5))
    by_time, by_rate, by_light = figure.subplots(1, 3, sharey=True)
    for number, name in enumerate(dict.fromkeys(row["method"] for row in rows)):
        own = [row for row in rows if row["method"] == name]
        full = [row for row in own if row["rate_by"] == "full"]
        usual = [row for row in full if row["light"] == 1]
        if usual:
            bars(by_time, {float(np.median([r["seconds"] for r in usual])): errors(usual)}, number, name)
        for how, style in (("reintegrate", "-"), ("drop", ":")):
            slower = usual + [row for row in own if row["rate_by"] == how]
            bars(by_rate, _errors_by(slower, "rate_hz"), number, style=style)
        bars(by_light, _errors_by(full, "light"), number)
    log_axes(by_time, "seconds an image", IMAGE_ERROR)
    log_axes(by_rate, "planes a second (solid: re-integrated, dotted: dropped)", "")
    log_axes(by_light, "times the usual light", "")
    db_scale(by_time)
    by_time.legend(fontsize=8, frameon=False)
    write_figure(path, figure, caption(document, rows, BARS))


def _errors_by(rows: Sequence[dict], key: str) -> dict[float, list[float]]:
    return {place: errors([r for r in rows if r[key] == place]) for place in sorted({r[key] for r in rows})}


def plot_poses(path: Path, document: dict) -> None:
    """Draw the errors of cameras and points against run time, and of cameras against rig error, views and length.

    Runs that were refused are not drawn; the document lists them.
    """
    rows = [r for r in document["rows"] if "rotation_deg" in r]
    trials = [r for r in rows if r["method"] == "natural.trial"]
    figure = new_figure("Poses: error against run time, rig error, views and length", (14, 8))
    (by_time, points, *swept), methods = figure.subplots(2, 3).flat, dict.fromkeys(r["method"] for r in rows)
    plain = [r for r in rows if "abs_rel" in r or "scale_percent" in r]  # boards are scored without depths
    for number, method in enumerate(name for name in methods if name != "natural.trial"):
        own = [r for r in plain if r["method"] == method]
        for axes, score in ((by_time, "rotation_deg"), (points, "points_abs_rel")):
            found = [r for r in own if r.get(score, 0) > 0]
            if found:
                seconds = max(float(np.median([r["seconds"] for r in found])), LEAST_S)
                bars(axes, {seconds: [r[score] for r in found]}, number, method)
        for axes, (key, _) in zip(swept, SWEEPS, strict=False):
            _summarised(axes, document["summary"], f"{method}.{key}", COLOURS[number % len(COLOURS)])
    dots = {"color": "#999", "markersize": 2, "label": f"natural, {len(trials)} random rigs"}
    swept[0].plot([r["turn_deg"] for r in trials], [r.get("rotation_deg") for r in trials], ".", **dots)
    log_axes(by_time, "wall seconds, images included", "mean rotation error / degrees")
    log_axes(points, "wall seconds, images included", "Abs Rel of the method's own points")
    for axes, (_, name) in zip(swept, SWEEPS, strict=False):
        log_axes(axes, name, "mean rotation error / degrees", log_x=False)
    by_time.legend(fontsize=7, frameon=False)
    swept[0].legend(fontsize=7, frameon=False)
    swept[-1].set_visible(False)
    write_figure(path, figure, caption(document, plain, BARS))


def _summarised(axes: Axes, summary: dict[str, float], start: str, colour: str) -> None:
    """Draw the mean rotation errors that the summary names by `start` and a number."""
    named = re.compile(rf"{re.escape(start)}([\d.]+)\.rotation_deg")
    places = sorted((float(match[1]), value) for key, value in summary.items() if (match := named.fullmatch(key)))
    if places:
        axes.plot(*zip(*places, strict=True), "o-", color=colour, markersize=4, linewidth=1)


def plot_leave_out(path: Path, document: dict) -> None:
    """Draw a line a case from its plan to everything on, and saved against claimed seconds of single decisions."""
    figure = new_figure("What a plan leaves out", (11, 6.8))
    grid = figure.add_gridspec(2, len(LEFT_OUT))
    rows = [r for r in document["rows"] if r["decision"] == "all" and "refused" not in r]
    cases = list(dict.fromkeys(r["case"] for r in rows))
    for i, (key, label, timed) in enumerate(LEFT_OUT):
        axes = figure.add_subplot(grid[0, i])
        _pairs(axes, [r for r in rows if r["extent"].endswith("s") == timed], cases, key)
        name_axes(axes, label, "")
        axes.set_yticks(range(len(cases)), ["" if i else case for case in cases], fontsize=8)
        axes.invert_yaxis()
        if not i:
            axes.legend(fontsize=7)
    _claims(figure.add_subplot(grid[1, :]), document["summary"])
    write_figure(path, figure, caption(document, rows))


def plot_defects(path: Path, document: dict) -> None:
    """Draw what each defect takes from the clean recording of its scene, with its cure and without."""
    summary = document["summary"]
    names = [key.removesuffix(".cost_db") for key in summary if key.endswith(".cost_db")]
    figure = new_figure("What defects cost, with their cures and without", (9, 1.5 + 0.3 * len(names)))
    axes = figure.subplots()
    for number, (score, label) in enumerate((("uncured_cost_db", "without the cure"), ("cost_db", "with it"))):
        places = [
            (summary[f"{name}.{score}"], place) for place, name in enumerate(names) if f"{name}.{score}" in summary
        ]
        if places:
            axes.plot(*zip(*places, strict=True), "o", color=COLOURS[number], label=label)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.invert_yaxis()
    axes.axvline(0.0, color="#999", linewidth=1)
    axes.set_xlabel("dB below the recording of the same scene that it is held against")
    axes.legend(fontsize=8, frameon=False)
    write_figure(path, figure, caption(document, document["rows"]))


def _pairs(axes: Axes, rows: list[dict], cases: list[str], key: str) -> None:
    """Draw the dots of `plan` and `all`, joined, a line a case."""
    for y, case in enumerate(cases):
        found = [r[key] for r in rows if r["case"] == case]
        axes.plot(found, [y] * len(found), "-", color="#bbb", zorder=1)
    for run, colour in (("plan", COLOURS[0]), ("all", COLOURS[1])):
        some = [r for r in rows if r["run"] == run]
        axes.plot([r[key] for r in some], [cases.index(r["case"]) for r in some], "o", color=colour, label=run)


def _claims(axes: Axes, summary: dict[str, float]) -> None:
    """Draw what each decision saved beside what the plan claimed."""
    names = [key.removesuffix(".claimed_s") for key in summary if key.endswith(".claimed_s")]
    names = [name for name in names if f"{name}.saved_s" in summary]
    for shift, what, colour in ((-0.2, "claimed", "#999"), (0.2, "saved", COLOURS[2])):
        places = [i + shift for i in range(len(names))]
        axes.bar(places, [summary[f"{name}.{what}_s"] for name in names], 0.4, color=colour, label=what)
    name_axes(axes, "", "processor seconds")
    axes.set_xticks(range(len(names)), names, fontsize=8, rotation=20, ha="right")
    if names:
        axes.legend(fontsize=7)


def plot_viewpoints(path: Path, document: dict) -> None:
    """Draw each line's scores by metres along it: a thin line a scene, a thick black one for their mean."""
    figure = new_figure("Views nobody captured", (11, 8))
    scenes = list(dict.fromkeys(row["scene"] for row in document["rows"]))
    panels = figure.subplots(len(SEEN), len(LINES), sharey="row")
    for row, (score, label) in zip(panels, SEEN, strict=True):
        for axes, line in zip(row, LINES, strict=True):
            _along(axes, [r for r in document["rows"] if r["line"] == line and score in r], scenes, score)
            name_axes(axes, f"{line}: metres along the line", label if line == LINES[0] else "")
            if score == "abs_rel":
                axes.set_yscale("log")
    panels[-1][0].legend(fontsize=7, frameon=False)
    write_figure(path, figure, caption(document, document["rows"], "Cameras stand at -0.2, 0 and 0.2 m."))


def _along(axes: Axes, rows: list[dict], scenes: list[str], score: str) -> None:
    for i, scene in enumerate(scenes):
        own = sorted((r["along_m"], r[score]) for r in rows if r["scene"] == scene)
        axes.plot([x for x, _ in own], [y for _, y in own], color=COLOURS[i], linewidth=0.8, alpha=0.7, label=scene)
    places = sorted({row["along_m"] for row in rows})
    means = [np.mean([r[score] for r in rows if r["along_m"] == place]) for place in places]
    axes.plot(places, means, "k.-", linewidth=1.8, label="mean")


def plot_stability(path: Path, document: dict) -> None:
    """Draw the losses of every step by scene, and below them the relative gaps; `document` has `curves`."""
    figure = new_figure("Trainings in float32 (thin) and float64 (wide)", (7.5, 7.0))
    losses, gaps = figure.subplots(2, 1, sharex=True)
    for (scene, curves), colour in zip(document["curves"].items(), COLOURS, strict=False):
        if curves.keys() >= {"float32", "float64"}:
            single, double = (np.array(curves[name]) for name in ("float32", "float64"))
            apart = np.abs(single / double - 1)
            losses.plot(double, color=colour, linewidth=2.5, alpha=0.35)
            losses.plot(single, color=colour, linewidth=0.8, label=scene)
            gaps.plot(np.where(apart > 0, apart, np.nan), color=colour, linewidth=0.8)
    name_axes(losses, "", "loss")
    name_axes(gaps, "training step", "float32 against float64, relative")
    for axes in (losses, gaps):
        if any(np.nanmax(line.get_ydata(), initial=0.0) > 0 for line in axes.lines):
            axes.set_yscale("log")
    if losses.lines:
        losses.legend(fontsize=8)
    write_figure(path, figure, caption(document, []))


_DRAWN = (
    *(plot_images, plot_defects, plot_leave_out, plot_poses),
    *(plot_long, plot_rivals, plot_speed, plot_stability, plot_training, plot_uncertainty, plot_viewpoints),
)
PLOTS: Mapping[str, Callable[[Path, dict], None]] = {  # by the bench that each is named for
    "large": plot_speed,
    **{plot.__name__.removeprefix("plot_").replace("_", "-"): plot for plot in _DRAWN},
}
