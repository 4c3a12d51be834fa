"""Draws the loss curves of the stiff scenes: float32 beside float64, and the gap between them."""

from pathlib import Path

import numpy as np

from reconstruction.bench.figures import COLOURS, caption, name_axes, new_figure, write_figure


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
