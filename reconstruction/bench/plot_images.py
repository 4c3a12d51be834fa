"""The image bench as a picture: error against run time, against plane rate and against light, logarithmic both ways."""

import io
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from acquisition.durable import write_durably

MARKERS = "osD^vPX*<>"
LABELS = ("milliseconds an image", "planes a second (solid: re-integrated, dotted: dropped)", "times the usual light")


def plot_images(path: Path, document: dict) -> None:
    """Draw RMS errors as a share of white: a point a scene, seed and method; a line a method over rates and lights."""
    rows = [row for row in document["rows"] if row.get("part") == "scenes" and "psnr_db" in row]
    figure = Figure(figsize=(13, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 3, sharey=True)
    for number, name in enumerate(dict.fromkeys(row["method"] for row in rows)):
        own = [row for row in rows if row["method"] == name]
        full = [row for row in own if row["rate_by"] == "full"]
        usual = [row for row in full if row["light"] == 1]
        style = {"color": f"C{number}", "marker": MARKERS[number % len(MARKERS)], "label": name, "markersize": 5}
        axes[0].plot([1e3 * r["seconds"] for r in usual], [_error(r) for r in usual], linestyle="", **style)
        for how, line in (("reintegrate", "-"), ("drop", ":")):
            slow = usual + [row for row in own if row["rate_by"] == how]
            _mean_line(axes[1], [(r["rate_hz"], _error(r)) for r in slow], linestyle=line, **style)
        _mean_line(axes[2], [(r["light"], _error(r)) for r in full], linestyle="-", **style)
    for axis, label in zip(axes, LABELS, strict=True):
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlabel(label)
        axis.grid(True, which="both", alpha=0.3)
    axes[0].set_ylabel("RMS error, share of white")
    axes[0].legend(fontsize=8)
    device = document["device"]
    figure.suptitle(f"{device['processor']}, {device['threads']} threads; {document['revision']}", fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    write_durably(path, buffer.getvalue())


def _error(row: dict) -> float:
    return 10 ** (-row["psnr_db"] / 20)


def _mean_line(axes: Axes, points: list[tuple[float, float]], **style: object) -> None:
    places = sorted({x for x, _ in points})
    means = [[y for at, y in points if at == x] for x in places]
    axes.plot(places, [sum(y) / len(y) for y in means], **style)  # type: ignore[arg-type]
