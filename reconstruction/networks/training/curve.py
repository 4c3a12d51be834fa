"""Draws the curves of trainings: their scores against the wall time they took."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure

from acquisition.durable import made_aside
from reconstruction.errors import BadRunError

COLOURS = ("#1f5fa8", "#c26a1b", "#3b8f4d")


class Panel(NamedTuple):
    """One pair of axes: the label of y, each score's line style and legend, and the scales of x and y."""

    label: str
    lines: Mapping[str, tuple[str, str]]
    scales: tuple[str, str]


IMAGE_PANELS = (
    Panel(
        "PSNR / dB",
        {
            "random_db": (":", "random scenes"),
            "development_db": ("--", "fan_and_ball, development seeds"),
            "moving_db": ("-", "its moving pixels"),
        },
        ("log", "linear"),
    ),
)
MSDI_PANELS = tuple(
    Panel(label, {f"random_{name}": (":", "random"), f"development_{name}": ("-", "development")}, ("linear", scale))
    for name, label, scale in (
        ("deg", "pose error / degrees", "log"),
        ("abs_rel", "depth, Abs Rel", "log"),
        ("db", "images, PSNR / dB", "linear"),
    )
)


def plot_curves(trainings: Sequence[Path], out: Path) -> None:
    """Draw `training.json` files, all of image networks or all of MSDI; raises BadRunError for one without scores."""
    documents = [_read(path) for path in trainings]
    panels = _panels(documents[0])
    figure = Figure(figsize=(7.5, 4.6) if len(panels) == 1 else (11, 3.6), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for document, colour in zip(documents, COLOURS * len(documents), strict=False):
        seconds = [point["seconds"] for point in document["curve"]]
        for drawn, panel in zip(axes, panels, strict=True):
            for name, (style, label) in panel.lines.items():
                values = [point.get(name, float("nan")) for point in document["curve"]]
                drawn.plot(seconds, values, style, marker=".", color=colour, label=f"{_name(document)}, {label}")
        device = document["device"]
        figure.suptitle(f"{device['processor']}, {device['threads']} threads, shared with others", fontsize=8)
    for drawn, panel in zip(axes, panels, strict=True):
        drawn.set(xlabel="wall seconds of training", ylabel=panel.label, xscale=panel.scales[0], yscale=panel.scales[1])
        drawn.grid(True, which="both", alpha=0.3)
    axes[0].legend(fontsize=8)
    with made_aside(out) as aside:
        figure.savefig(aside, format="png", dpi=110)


def _panels(document: dict) -> tuple[Panel, ...]:
    return MSDI_PANELS if "joint" in document["config"] else IMAGE_PANELS


def _name(document: dict) -> str:
    config = document["config"]
    return ("joint" if config["joint"] else "separate") if "joint" in config else document["network"]


def _read(path: Path) -> dict:
    try:
        document = json.loads(path.read_text())
        needed = {next(iter(panel.lines)) for panel in _panels(document)}
        if not document["curve"] or not all(needed <= set(point) for point in document["curve"]):
            raise ValueError("no scores")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadRunError(f"found no curve of a training ({error})", "its training.json", where=path) from error
    return document
