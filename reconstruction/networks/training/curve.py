"""Draws the curves of trainings: their scores against the wall time they took."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from acquisition.durable import made_aside
from reconstruction.errors import BadRunError

COLOURS = ("#1f5fa8", "#c26a1b", "#3b8f4d", "#8a4fa3", "#a33b3b")
IMAGE_LINES = {  # the style and the legend of each score
    "random_db": (":", "random scenes"),
    "development_db": ("--", "fan_and_ball, development seeds"),
    "moving_db": ("-", "its moving pixels"),
}
MSDI_SCORES = {  # the label and the scale of each axis
    "deg": ("pose error / degrees", "log"),
    "abs_rel": ("depth, Abs Rel", "log"),
    "db": ("images, PSNR / dB", "linear"),
}


def plot_curves(trainings: Sequence[Path], out: Path) -> None:
    """Draw `training.json` files, all of image networks or all of MSDI; raises BadRunError for one without scores.

    Trainings that led to one are drawn before it, each as a line of its own: their validations may differ.
    """
    documents = [part for path in trainings for part in _parts(path)]
    panels = _panels(documents[0])
    figure = Figure(figsize=(7.5, 4.8) if len(panels) == 1 else (11, 4.0), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for document, colour in zip(documents, COLOURS * len(documents), strict=False):
        seconds = [document["begun"] + point["seconds"] for point in document["curve"]]
        for drawn, (_, _, lines) in zip(axes, panels, strict=True):
            for name, (style, label) in lines.items():
                values = [point.get(name, float("nan")) for point in document["curve"]]
                drawn.plot(seconds, values, style, marker=".", color=colour, label=f"{_name(document)}, {label}")
        device = document["device"]
        figure.suptitle(f"{device['processor']}, {device['threads']} threads, shared with others", fontsize=8)
    time_scale = "log" if panels[0][2] is IMAGE_LINES else "linear"
    for drawn, (label, scale, _) in zip(axes, panels, strict=True):
        drawn.set(xlabel="wall seconds of training", ylabel=label, xscale=time_scale, yscale=scale)
        drawn.grid(True, which="both", alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    with made_aside(out) as aside:
        figure.savefig(aside, format="png", dpi=110)


def _panels(document: dict) -> list[tuple[str, str, Mapping[str, tuple[str, str]]]]:
    """Return the label and the scale of each pair of axes, and the scores that it shows."""
    if "joint" not in document["config"]:
        return [("PSNR / dB", "linear", IMAGE_LINES)]
    return [
        (*axis, {f"random_{name}": (":", "random"), f"development_{name}": ("-", "development")})
        for name, axis in MSDI_SCORES.items()
    ]


def _name(document: dict) -> str:
    config, begun = document["config"], document["begun"]
    if begun:
        return f"on from {begun:.0f} s"
    return ("joint" if config["joint"] else "separate") if "joint" in config else document["network"]


def _parts(path: Path) -> list[dict]:
    """Return the trainings that led to the one in `path`, and itself, each with the second at which it has `begun`."""
    try:
        document = json.loads(path.read_text())
        parts, begun = [*document.get("after", []), document], 0.0
        for part in parts:
            needed = {next(iter(lines)) for _, _, lines in _panels(part)}
            if not part["curve"] or not all(needed <= set(point) for point in part["curve"]):
                raise ValueError("no scores")
            part["begun"] = begun
            begun += part["curve"][-1]["seconds"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise BadRunError(f"found no curve of a training ({error})", "its training.json", where=path) from error
    return parts
