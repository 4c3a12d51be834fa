"""The loss curves of the stiff scenes as a picture: float32 beside float64, and how far they are apart."""

import io
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from acquisition.durable import write_durably


def plot_stability(path: Path, document: dict) -> None:
    """Above the losses of every step by scene (colour), below their relative gaps; `document` has `curves`."""
    figure = Figure(figsize=(7.5, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    losses, gaps = figure.subplots(2, 1, sharex=True)
    for number, (scene, curves) in enumerate(document["curves"].items()):
        if curves.keys() >= {"float32", "float64"}:
            _scene(losses, gaps, (scene, f"C{number}"), curves)
    losses.set_ylabel("loss")
    gaps.set_ylabel("float32 against float64, relative")
    gaps.set_xlabel("training step")
    for axes in (losses, gaps):
        if any(np.nanmax(line.get_ydata(), initial=0.0) > 0 for line in axes.lines):
            axes.set_yscale("log")
        axes.grid(True, which="both", alpha=0.3)
    if losses.lines:
        losses.legend(fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    write_durably(path, buffer.getvalue())


def _scene(losses: Axes, gaps: Axes, named: tuple[str, str], curves: dict) -> None:
    """One scene's two lines above and one below; gaps of nothing are not drawn."""
    scene, color = named
    single, double = (np.array(curves[name]) for name in ("float32", "float64"))
    losses.plot(double, color=color, linewidth=2.5, alpha=0.35)
    losses.plot(single, color=color, linewidth=0.8, label=scene)
    apart = np.abs(single / double - 1)
    gaps.plot(np.where(apart > 0, apart, np.nan), color=color, linewidth=0.8)
