"""The pose bench as a picture: error against run time, and against nominal error, views and recording length."""

import io
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from acquisition.durable import write_durably

MARKS = "os^Dvphx"
LEAST_S = 0.05  # where a method that does nothing is drawn


def plot_poses(path: Path, document: dict) -> None:
    """Colour: method; mark: scene. Rows that were refused are not drawn; the document lists them."""
    figure = Figure(figsize=(9.5, 7.6), layout="constrained")
    FigureCanvasAgg(figure)
    (by_time, by_error), (by_views, by_planes) = figure.subplots(2, 2)
    rows = [r for r in document["rows"] if "rotation_deg" in r]
    methods = list(dict.fromkeys(r["method"] for r in rows if r["method"] != "natural.trial"))
    _draw_runs(by_time, rows, methods)
    for number, method in enumerate(methods):
        for axes, key in ((by_error, "nominal"), (by_views, "views"), (by_planes, "planes")):
            _draw_means(axes, document["summary"], method, key, f"C{number}")
    trials = [r for r in rows if r["method"] == "natural.trial"]
    grey = {"color": "#999", "markersize": 2, "label": f"natural, {len(trials)} random rigs"}
    by_error.plot([r["turn_deg"] for r in trials], [r["rotation_deg"] for r in trials], ".", **grey)
    by_error.legend(fontsize=7)
    names = ("wall seconds, images included", "error of the nominal rig / degrees, cm, %", "views", "planes recorded")
    for axes, name in zip((by_time, by_error, by_views, by_planes), names, strict=True):
        axes.set_xlabel(name)
        axes.set_yscale("log")
        axes.set_ylabel("mean rotation error / degrees")
        axes.grid(True, which="both", alpha=0.3)
    device = document["device"]
    about = f"{device['processor']}, {device['threads']} threads; revision {document['revision']}"
    figure.suptitle(about, fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    write_durably(path, buffer.getvalue())


def _draw_runs(axes: Axes, rows: list[dict], methods: list[str]) -> None:
    """Error against run time of the plain runs, which alone are scored with depths; boards are a run of their own."""
    scenes = list(dict.fromkeys(r["scene"] for r in rows))
    for row in rows:
        if "abs_rel" in row or "scale_percent" in row:
            mark, colour = MARKS[scenes.index(row["scene"]) % len(MARKS)], f"C{methods.index(row['method'])}"
            axes.plot(max(row["seconds"], LEAST_S), row["rotation_deg"], mark, color=colour, markersize=5)
    for number, method in enumerate(methods):
        axes.plot([], [], "o", color=f"C{number}", label=method)
    axes.set_xscale("log")
    axes.legend(fontsize=7)


def _draw_means(axes: Axes, summary: dict[str, float], method: str, key: str, colour: str) -> None:
    """The means of one method over the values of `key`."""
    start, end = f"{method}.{key}", ".rotation_deg"
    found = {
        float(name[len(start) : -len(end)]): value
        for name, value in summary.items()
        if name.startswith(start) and name.endswith(end)
    }
    if found:
        places = sorted(found)
        axes.plot(places, [found[x] for x in places], "o-", color=colour, markersize=4, linewidth=1)
