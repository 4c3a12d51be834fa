"""The curves of MSDI's trainings as a picture: pose error, depth error and image error against time."""

import io
import json
from collections.abc import Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from acquisition.durable import write_durably
from reconstruction.errors import BadRunError

PANELS = {"deg": "pose error / degrees", "abs_rel": "depth, Abs Rel", "db": "images, PSNR / dB"}
KINDS = {"random": ":", "development": "-"}
COLOURS = ("#1f5fa8", "#c26a1b", "#3b8f4d")


def plot_curves(trainings: Sequence[Path], out: Path) -> None:
    """Draw the `training.json` files; raises BadRunError for one that has no scores."""
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(PANELS))
    for number, path in enumerate(trainings):
        document = _read(path)
        seconds = [point["seconds"] for point in document["curve"]]
        way = "joint" if document["config"]["joint"] else "separate"
        for panel, (name, label) in zip(axes, PANELS.items(), strict=True):
            for kind, style in KINDS.items():
                values = [point.get(f"{kind}_{name}", float("nan")) for point in document["curve"]]
                panel.plot(seconds, values, style, marker=".", color=COLOURS[number % 3], label=f"{way}, {kind}")
            panel.set_xlabel("wall seconds of training")
            panel.set_ylabel(label)
            panel.grid(True, which="both", alpha=0.3)
            if name != "db":
                panel.set_yscale("log")
        device = document["device"]
        figure.suptitle(f"{device['processor']}, {device['threads']} threads, shared with others", fontsize=8)
    axes[0].legend(fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    write_durably(out, buffer.getvalue())


def _read(path: Path) -> dict:
    try:
        document = json.loads(path.read_text())
        if not document["curve"] or not all(f"random_{name}" in document["curve"][-1] for name in PANELS):
            raise ValueError("no scores")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadRunError(f"found no curve of a training ({error})", "its training.json", where=path) from error
    return document
