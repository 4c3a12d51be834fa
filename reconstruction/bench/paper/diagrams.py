"""Draws the document of the paper bench: what each part buys, where the seconds go, and error against what is swept."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from reconstruction.bench.figures import (
    COLOURS,
    MARKS,
    bars,
    caption,
    chart,
    errors,
    name_axes,
    new_figure,
    write_figure,
)
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.method import Table
from reconstruction.bench.paper.protocol import CHAIN, MODULES, PROTOCOL, SWEPT
from reconstruction.bench.paper.summary import gaps
from reconstruction.bench.paper.tables import unprinted
from reconstruction.bench.score_run import STAGES
from reconstruction.methods.ours import BASES

ERROR = "RMS error of the held-out view / white  (PSNR)"
SECONDS = "wall seconds, from recording to result"
BARS = "Mark: median; bar: lowest to highest of recordings."
DOTS = "Bar: mean; mark: a recording."
SWEEPS = {  # a number in a method's name: its axis, and its value where the name has none
    "views": ("training views", len(m.VIEWS)),
    "gaussians": ("most Gaussians", BASES.gaussians),
    "drop": ("planes a second", m.RATE_HZ),
    "reintegrate": ("planes a second", m.RATE_HZ),
}
HOW = {"drop": "planes dropped", "reintegrate": "planes re-integrated"}
SCORES = {"psnr_db": "whole view", "dynamic_psnr_db": "movers"}
STAGED = {table.name: table for table in (MODULES, CHAIN)}  # the tables whose rows' stages are drawn


def write_diagrams(out: Path, document: dict) -> list[Path]:
    """Write each diagram whose table is complete as `paper-TABLE.png`, and return what was written."""
    drawn: dict[str, Callable[[Path], bool]] = {
        "chain": lambda path: _parts(path, document, CHAIN),
        "modules": lambda path: _parts(path, document, MODULES),
        "stages": lambda path: _stages(path, document),
        "gaussians": lambda path: _sweep(path, document, ("gaussians",), "Error against the number of Gaussians"),
        "views": lambda path: _sweep(path, document, ("views",), "Error against training views"),
        "rates": lambda path: _sweep(path, document, ("drop", "reintegrate"), "Error against plane rate"),
    }
    lacking = unprinted(document, (table.name for table in PROTOCOL.tables))
    wanted = [name for name in drawn if not lacking.intersection(STAGED if name == "stages" else (name,))]
    paths = {name: out / f"paper-{name}.png" for name in wanted}
    return [path for name, path in paths.items() if drawn[name](path)]


def _parts(path: Path, document: dict, table: Table) -> bool:
    """Draw how far each row of a table lies from its first one, on the recordings that both have."""
    first, *rest = [row for row in table.rows if row.method]
    name = first.method.name if first.method else ""
    apart = {
        row.label: [gaps(document["rows"], row.method.name, name, _length(table), score) for score in SCORES]
        for row in rest
        if row.method
    }
    apart = {label: found for label, found in apart.items() if all(found)}
    if not apart:
        return False
    figure = new_figure(table.title, (8.6, 1.6 + 0.36 * len(apart)))
    axes = figure.subplots()
    for number, label in enumerate(SCORES.values()):
        places, levels = np.arange(len(apart)) + 0.36 * number - 0.18, [found[number] for found in apart.values()]
        axes.barh(places, [np.mean(some) for some in levels], 0.34, color=COLOURS[number], alpha=0.55, label=label)
        for place, some in zip(places, levels, strict=True):
            axes.plot(some, [place] * len(some), MARKS[number], color=COLOURS[number], markersize=3.5)
    axes.set_yticks(range(len(apart)), list(apart), fontsize=8)
    name_axes(axes, f"dB to: {first.label}", "")
    axes.invert_yaxis()
    _legend_above(axes, len(SCORES))
    write_figure(path, figure, caption(document, _of(document, table), DOTS))
    return True


def _of(document: dict, table: Table) -> list[dict]:
    """Return the rows of the methods of a table at its length."""
    names = {row.method.name for row in table.rows if row.method}
    return [row for row in document["rows"] if row["method"] in names and row["effort"] == _length(table)]


def _length(table: Table) -> str:
    """Return the label of the one length of a table's runs."""
    (length,) = {effort.label for batch in PROTOCOL.batches if batch.table == table.name for effort in batch.efforts}
    return length


def _legend_above(axes: Axes, columns: int) -> None:
    axes.legend(fontsize=8, frameon=False, ncols=columns, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def _stages(path: Path, document: dict) -> bool:
    """Draw the seconds of each stage of the rows of the chain and of ours, means over recordings."""
    rows = {
        f"{table.name}: {row.label}": [r for r in _of(document, table) if row.method and r["method"] == row.method.name]
        for table in STAGED.values()
        for row in table.rows
    }
    own = {label: found for label, found in rows.items() if found}
    if not own:
        return False
    figure = new_figure("Where the seconds go", (8.6, 1.6 + 0.26 * len(own)))
    axes, left = figure.subplots(), np.zeros(len(own))
    for number, stage in enumerate(STAGES):
        width = np.array([np.mean([row[f"seconds.{stage}"] for row in found]) for found in own.values()])
        axes.barh(list(own), width, left=left, color=COLOURS[number], label=stage, height=0.65)
        left += width
    axes.tick_params(axis="y", labelsize=8)
    name_axes(axes, "wall seconds, mean over recordings", "")
    axes.invert_yaxis()
    _legend_above(axes, len(STAGES))
    write_figure(path, figure, caption(document, [row for found in own.values() for row in found]))
    return True


def _sweep(path: Path, document: dict, kinds: Sequence[str], title: str) -> bool:
    """Draw error against a number in the methods' names, such as `auto.views5`."""
    drawn = [found for kind in kinds for found in _swept(document["rows"], kind)]
    if not drawn:
        return False
    rows = [r for _, found in drawn for some in found.values() for r in some]
    with chart(path, title, (SWEEPS[kinds[0]][0], ERROR), caption(document, rows, BARS)) as axes:
        for number, (name, found) in enumerate(drawn):
            bars(axes, {place: errors(found[place]) for place in sorted(found)}, number, name)
    return True


def _swept(rows: Sequence[dict], kind: str) -> list[tuple[str, dict[int, list[dict]]]]:
    """Return, for each method that was swept, its rows by number; the method as it is stands at its usual number."""
    named = re.compile(rf"(.+)\.{kind}(\d+)")
    places: dict[str, dict[int, list[dict]]] = {}
    for row in rows:
        match = named.fullmatch(row["method"])
        if match:
            places.setdefault(match[1], {}).setdefault(int(match[2]), []).append(row)
    drawn = []
    for method, found in places.items():
        alike = {(r["scene"], r["seed"], r["effort"]) for some in found.values() for r in some}
        whole = [r for r in rows if r["method"] == method and (r["scene"], r["seed"], r["effort"]) in alike]
        label = SWEPT.get(method, method)
        name = f"{label}, {HOW[kind]}" if kind in HOW else label
        drawn.append((name, ({SWEEPS[kind][1]: whole} if whole else {}) | found))
    return drawn
