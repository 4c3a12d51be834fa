"""The training bench as a picture: error against run time, one line a run."""

import io
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from acquisition.durable import write_durably


def plot_training(path: Path, document: dict) -> None:
    """The curves of every scene's automatic runs (colour: scene), and below each method's final level by scene."""
    figure = Figure(figsize=(7.5, 8.2), layout="constrained")
    FigureCanvasAgg(figure)
    curves, levels = figure.subplots(2, 1)
    scenes = list(dict.fromkeys(row["scene"] for row in document["rows"]))
    for row in (r for r in document["rows"] if r["method"] == "auto"):
        longest = row["budget_s"] == max(r["budget_s"] for r in document["rows"] if r["method"] == "auto")
        curves.plot(
            [p["seconds"] for p in row["curve"]],
            [p["psnr_db"] for p in row["curve"]],
            ".-",
            color=f"C{scenes.index(row['scene'])}",
            linewidth=1,
            label=row["scene"] if longest else None,
        )
    for name, style in (("depth_blend", "--"), ("nearest_view", ":")):
        level = document["summary"].get(f"{name}.psnr_db")
        if level is not None:
            curves.axhline(level, linestyle=style, color="#777", label=name.replace("_", " "))
    curves.set_xscale("log")
    curves.set_xlabel("wall seconds, images and initialisation included, evaluation not")
    _levels(levels, document, scenes)
    device = document["device"]
    curves.set_title(f"{device['processor']}, {device['threads']} threads; revision {document['revision']}", fontsize=8)
    for axes in (curves, levels):
        axes.set_ylabel("PSNR of the held-out centre view / dB")
        axes.grid(True, which="both", alpha=0.3)
    curves.legend(fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    write_durably(path, buffer.getvalue())


def _levels(axes: Axes, document: dict, scenes: list[str]) -> None:
    """Each method's final level at each budget, one mark a scene."""
    names = list(dict.fromkeys(f"{r['method']} @{r['budget_s']:g}" for r in document["rows"]))
    for row in document["rows"]:
        x = names.index(f"{row['method']} @{row['budget_s']:g}")
        axes.plot(x, row["psnr_db"], "o", color=f"C{scenes.index(row['scene'])}", markersize=4)
    axes.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
