"""Draws and writes the document of the bench of expected errors."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from acquisition.durable import write_durably
from reconstruction.bench.figures import COLOURS, MARKS, caption, log_axes, name_axes, new_figure, write_figure
from reconstruction.bench.uncertainty.bench import ALIKE

INTRODUCTION = """# Expected errors

`spike4dgs bench uncertainty`, revision {revision}, {processor}, {threads} threads; drawn from
[uncertainty.json](uncertainty.json).

The root mean square of render minus truth, over white, beside what was expected of it. Weights of the expectation were
fitted on other scenes, never on the one that a row is of, or on one that is like it: {alike}
are the same things before other backgrounds. The rank correlation is that of blocks of 16x16 pixels, as a mean over
three instants. Distances are metres from the corner camera (beyond), or from the array's middle.
"""


def plot_uncertainty(path: Path, document: dict) -> None:
    """Draw expected against true errors, and the rank correlation along the line that leaves the array."""
    rows = document["rows"]
    figure = new_figure("Expected errors against true ones", (11, 5))
    both, ranks = figure.subplots(1, 2)
    ends = [0.7 * min(row["true"] for row in rows), 1.4 * max(row["true"] for row in rows)]
    for factor, style in ((1.0, "-"), (2.0, ":"), (0.5, ":")):
        both.plot(ends, [factor * end for end in ends], style, color="#999", linewidth=1)
    for number, line in enumerate(dict.fromkeys(row["line"] for row in rows)):
        own = [row for row in rows if row["line"] == line]
        look = {"color": COLOURS[number], "marker": MARKS[number], "linestyle": "", "label": line}
        both.plot([row["true"] for row in own], [row["expected"] for row in own], markersize=5, **look)
        places = sorted({row["along_m"] for row in own})
        middle = [float(np.mean([row["rank"] for row in own if row["along_m"] == place])) for place in places]
        ranks.plot(places, middle, **{**look, "linestyle": "-"})
    log_axes(both, "true error / white", "expected error / white")
    ranks.set_ylim(0, 1)
    name_axes(ranks, "metres along the line", "rank correlation over blocks, mean of scenes")
    both.legend(fontsize=8, frameon=False)
    write_figure(path, figure, caption(document, rows, "Dotted: twice and half the true error."))


def write_page(path: Path, document: dict) -> None:
    """Write the tables of a document."""
    alike = ", ".join(f"`{scene}`" for scene in sorted(ALIKE))
    head = INTRODUCTION.format(revision=document["revision"], alike=alike, **document["device"])
    weights = [f"| {name.removeprefix('weight.')} | {value:g} |" for name, value in _weights(document)]
    parts = [head, _table(document["rows"]), "## Weights\n\nOf all ray-cast scenes together.\n\n| term | weight |"]
    lines = "\n".join(["| --- | --- |", *weights])
    omissions = "\n".join(["## Omissions", "", *(f"- {line}" for line in document["omissions"])])
    write_durably(path, f"{parts[0]}\n{parts[1]}\n\n{parts[2]}\n{lines}\n\n{omissions}\n".encode())


def _weights(document: dict) -> list[tuple[str, float]]:
    return [(name, value) for name, value in document["summary"].items() if name.startswith("weight.")]


def _table(rows: Sequence[dict]) -> str:
    head = "| scene | view | along / m | true | expected | expected / true | rank correlation |"
    lines = [
        f"| {row['scene']} | {row['line']} | {row['along_m']:g} | {row['true']:.4f} | {row['expected']:.4f} | "
        f"{row['ratio']:.2f} | {row['rank']:.2f} |"
        for row in rows
    ]
    return "\n".join([head, "| --- " * 7 + "|", *lines])
