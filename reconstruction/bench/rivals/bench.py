"""Measures ours beside its rivals, each length as a run of its own, a scene at a time with all rows in turns.

The new scenes are drawn by a path tracer, and nothing was chosen on them. The old ones have been looked at. Ours was
developed on those of the first table.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from acquisition.bench_document import BenchDocument
from acquisition.durable import write_durably
from acquisition.progress import Progress
from acquisition.scenes.catalog import DEVELOPMENT, EVALUATION, REALISTIC, REALISTIC_EVALUATION
from reconstruction.bench.conventions import made_by, named
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.bench import run_protocol
from reconstruction.bench.paper.method import Batch, Effort, Method, Protocol, Row, Table
from reconstruction.bench.paper.run import Laboratory
from reconstruction.bench.paper.summary import gaps, name_of, summarise
from reconstruction.bench.paper.tables import omitted, sittings, whole_tables

SHORTEST, SHORT, LONG, HALF_HOUR = (Effort(seconds) for seconds in (15.0, 60.0, 300.0, 1800.0))
QUICK_EFFORT = Effort(steps=40)
OURS_STG = Method("stg", {"model": "stg"})
CHAIN = Method(
    "msdi-points+4dgs+variation",
    {"model": "4dgs", "images": "msdi", "init": "msdi", "tick_stride": 40, "supervision": "variation"},
    m.NOMINAL,
)
ROWS = (
    Row("Ours", m.AUTO),
    Row("Ours on clean images, at every 20th plane", m.CLEAN),
    Row("Our images + STG", OURS_STG),
    Row("TFI + STG", m.TFI["stg"], "TFI + STG"),
    Row("TFI + 4DGS", m.TFI["4dgs"], "TFI + 4DGS"),
    Row("TFI + D3DGS", m.TFI["d3dgs"], "TFI + D3DGS"),
    Row("Dy-SpikeGS", m.SPIKES["dy-spikegs"], "Dy-SpikeGS"),
    Row("the paper's chain as we read it, small MSDI, found poses", CHAIN, "Spike4DGS"),
)
LABELS = {row.method.name: row.label for row in ROWS if row.method}
METHODS = tuple(LABELS)


class Group(NamedTuple):
    """A table's title, scenes and lengths, the names of its methods (empty: all), and numbers of each scene's seeds."""

    title: str
    scenes: tuple[str, ...]
    lengths: tuple[Effort, ...]
    methods: tuple[str, ...] = ()
    seeds: tuple[int, ...] = (0,)

    @property
    def rows(self) -> tuple[Row, ...]:
        """The rows of its methods."""
        return tuple(row for row in ROWS if row.method and (not self.methods or row.method.name in self.methods))


SLOW = (m.TFI["4dgs"].name, CHAIN.name)
NEAR = (m.AUTO.name, OURS_STG.name)
GROUPS = {
    "development": Group("Scenes that ours was developed on", (*DEVELOPMENT, *REALISTIC), (SHORT, SHORTEST)),
    "half-hour": Group("Half an hour, for what makes few steps in a minute", REALISTIC[-1:], (HALF_HOUR,), SLOW),
    "new": Group("New scenes, path-traced, first run on 28 November 2026", REALISTIC_EVALUATION, (SHORT, SHORTEST)),
    "new-seeds": Group("New scenes by three seeds each", REALISTIC_EVALUATION, (SHORT,), NEAR, (0, 1, 2)),
    "old": Group("Old scenes, looked at often", EVALUATION, (SHORT, SHORTEST)),
    "new-long": Group("Up to five minutes, on two new scenes", REALISTIC_EVALUATION[:2], (LONG, SHORT, SHORTEST)),
}
SCORES = ("psnr_db", "dynamic_psnr_db")
ABOUT = "True poses but in the last row."


def rivals_protocol(*, quick: bool = False) -> Protocol:
    """Return the runs of the bench, scene by scene; `quick`: ours and one rival, in a few steps."""
    if quick:
        table = Table("new", "A check of the bench", "", ROWS)
        return Protocol((table,), (Batch("new", DEVELOPMENT, (QUICK_EFFORT,), METHODS[:3:2]),))
    tables = tuple(Table(name, group.title, ABOUT, group.rows) for name, group in GROUPS.items())
    batches = [
        Batch(name, (scene,), group.lengths, seeds=group.seeds)
        for name, group in GROUPS.items()
        for scene in group.scenes
    ]
    return Protocol(tables, tuple(batches))


def bench_rivals(
    protocol: Protocol, laboratory: Laboratory, progress: Progress, time_left: Callable[[], bool]
) -> BenchDocument:
    """Run the protocol and return its rows; the summary has means, and how far every row lies above ours."""
    document = run_protocol("rivals", protocol, laboratory, progress, time_left)
    summarise(document, protocol)
    for table in protocol.tables:
        names = {cell.name for row in table.rows for cell in protocol.wanted(table, row)}
        rows = [row for row in document.rows if name_of(row) in names]
        for name, effort in dict.fromkeys((row["method"], row["effort"]) for row in rows):
            for score in SCORES if name != m.AUTO.name else ():
                apart = gaps(rows, name, m.AUTO.name, effort, score)
                found = {"mean": float(np.mean(apart)), "most": max(apart)} if apart else {}
                document.summary |= named(f"{table.name}.{name}.above_ours.{score}", found, f"@{effort}")
    document.omissions.append("one seed a scene, but in `new-seeds`")
    return document


def write_page(path: Path, document: dict, protocol: Protocol) -> None:
    """Write the tables of which no run is left to be made, and name the others."""
    about = " ".join((__doc__ or "").split())
    parts = ["# Ours and its rivals", made_by(document), about, *whole_tables(document, protocol)]
    parts += [omitted(document), sittings(document["rows"])]
    write_durably(path, "\n\n".join(parts).encode() + b"\n")
