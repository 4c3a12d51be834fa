"""The training bench as a picture: error against run time, one line a run."""

import io
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from acquisition.durable import write_durably

COLOURS = ("#1f5fa8", "#c26a1b", "#3b8f4d", "#8a4fa3")


def plot_training(path: Path, document: dict) -> None:
    """Draw every run's curve (colour: budget) and the medians of the floors."""
    figure = Figure(figsize=(7.5, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    budgets = sorted({row["budget_s"] for row in document["rows"]})
    for row in document["rows"]:
        axes.plot(
            [p["seconds"] for p in row["curve"]],
            [p["psnr_db"] for p in row["curve"]],
            ".-",
            color=COLOURS[budgets.index(row["budget_s"]) % len(COLOURS)],
            linewidth=1,
            label=f"budget {row['budget_s']:g} s" if row["seed"] == document["rows"][0]["seed"] else None,
        )
    for name, style in (("depth_blend", "--"), ("nearest_view", ":")):
        axes.axhline(
            document["summary"][f"{name}.psnr_db"], linestyle=style, color="#777", label=name.replace("_", " ")
        )
    axes.set_xscale("log")
    axes.set_xlabel("wall seconds, images and initialisation included, evaluation and imports not")
    axes.set_ylabel("PSNR of the held-out centre view / dB")
    device = document["device"]
    axes.set_title(f"{device['processor']}, {device['threads']} threads; revision {document['revision']}", fontsize=8)
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    write_durably(path, buffer.getvalue())
