"""The curves of trainings as a picture: error against time."""

import io
import json
from collections.abc import Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from acquisition.durable import write_durably
from reconstruction.errors import BadRunError

LINES = {"random_db": ":", "development_db": "--", "moving_db": "-"}
LABELS = {
    "random_db": "random scenes",
    "development_db": "fan_and_ball, development seeds",
    "moving_db": "its moving pixels",
}
COLOURS = ("#1f5fa8", "#c26a1b", "#3b8f4d")


def plot_curves(trainings: Sequence[Path], out: Path) -> None:
    """Draw the `training.json` files; raises BadRunError for one that has no scores."""
    figure = Figure(figsize=(7.5, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for number, path in enumerate(trainings):
        document = _read(path)
        seconds = [point["seconds"] for point in document["curve"]]
        for name, style in LINES.items():
            values = [point[name] for point in document["curve"]]
            axes.plot(seconds, values, style, color=COLOURS[number % 3], label=f"{document['network']}: {LABELS[name]}")
        device = document["device"]
        axes.set_title(f"{device['processor']}, {device['threads']} threads, shared with others", fontsize=8)
    axes.set_xscale("log")
    axes.set_xlabel("wall seconds of training")
    axes.set_ylabel("PSNR / dB")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    write_durably(out, buffer.getvalue())


def _read(path: Path) -> dict:
    try:
        document = json.loads(path.read_text())
        if not all(name in point for point in document["curve"] for name in (*LINES, "seconds")):
            raise ValueError("no scores")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadRunError(f"found no curve of a training ({error})", "its training.json", where=path) from error
    return document
