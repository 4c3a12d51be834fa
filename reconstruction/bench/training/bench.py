"""Measures error against run time of whole reconstructions: the engine at several budgets, and one choice changed.

The runs are cells of a protocol, as those of the paper bench. `auto` is scored beside the floors.
"""

from collections.abc import Sequence

import numpy as np

from acquisition.bench_document import BenchDocument
from acquisition.progress import Progress
from acquisition.scenes.catalog import DEVELOPMENT, EVALUATION
from reconstruction.bench.conventions import means, named
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.bench import run_protocol
from reconstruction.bench.paper.method import Batch, Cell, Effort, Method, Protocol, Row, Table
from reconstruction.bench.paper.run import Laboratory
from reconstruction.bench.paper.summary import gaps
from reconstruction.bench.score_run import METRICS
from reconstruction.methods.catalogue import OURS

SHORT, MIDDLE, LONGEST = BUDGETS = (Effort(30.0), Effort(60.0), Effort(120.0))
TARGETS_DB = (28, 30, 31, 33, 34)
FLOORS = ("nearest_view", "depth_blend")
FOUR_DGS = Method("4dgs-small", {"model": "4dgs-small", "images": "tfi"})
ABLATIONS = (
    *(Method(f"model.{model.name}", {"model": model.name}) for model in OURS if model.moves),
    *(Method(f"supervision.{name}", {"supervision": name}) for name in m.SPIKE_LOSSES),
)
METHODS = (m.AUTO, m.CLEAN, FOUR_DGS, *ABLATIONS)
MARGINS = ((m.CLEAN, -1, LONGEST), (FOUR_DGS, 1, MIDDLE))  # ours less theirs; for the bound, theirs less ours


def training_protocol(scenes: tuple[str, ...] | None = None, *, quick: bool = False) -> Protocol:
    """Return the runs of the bench: all, or those on `scenes`; `quick`: the engine at one budget.

    A scene that is asked for is run by the whole engine, whichever kind it is.
    """
    chosen = (*EVALUATION, *DEVELOPMENT) if scenes is None else scenes
    engine = EVALUATION if scenes is None else scenes
    evaluated, developed = (tuple(s for s in kind if s in chosen) for kind in (EVALUATION, DEVELOPMENT))
    batches = [Batch("training", engine, (MIDDLE,) if quick else BUDGETS, (m.AUTO.name,))]
    if not quick:
        batches += [
            Batch("training", evaluated, (LONGEST,), (m.CLEAN.name,)),
            Batch("training", evaluated, (MIDDLE,), (FOUR_DGS.name,)),
            Batch("training", developed, (SHORT,), tuple(method.name for method in ABLATIONS)),
        ]
    table = Table("training", "Error against run time", "", tuple(Row(method.name, method) for method in METHODS))
    return Protocol((table,), tuple(batches))


def shown_cells(protocol: Protocol) -> list[Cell]:
    """Return the engine's longest run of each scene."""
    own = [cell for cell in protocol.cells() if cell.method == m.AUTO]
    longest = max((cell.effort.budget_s or 0.0 for cell in own), default=0.0)
    return [cell for cell in own if cell.effort.budget_s == longest]


def bench_training(protocol: Protocol, laboratory: Laboratory, progress: Progress) -> BenchDocument:
    """Run the protocol and return its rows, with means over scenes, times to levels, and margins in the summary."""
    laboratory.floors = (m.AUTO.name,)
    document = run_protocol("training", protocol, laboratory, progress)
    for name, effort in dict.fromkeys((r["method"], r["effort"]) for r in document.rows):
        document.summary |= named(name, means(_rows(document, name, effort), (*METRICS, "steps_per_s")), f"@{effort}")
    _add_times_to(document)
    _margins(document)
    document.omissions.append("one seed a scene")
    return document


def _rows(document: BenchDocument, method: str, effort: str) -> list[dict]:
    return [r for r in document.rows if (r["method"], r["effort"]) == (method, effort)]


def _add_times_to(document: BenchDocument) -> None:
    """Add the mean over recordings of the first second at which ours reached each level, or name those that did not."""
    for target in TARGETS_DB:
        times = times_to(document.rows, m.AUTO.name, target)
        reached = [t for t in times if t is not None]
        if reached and len(reached) == len(times):
            document.summary[f"{m.AUTO.name}.seconds_to_{target}"] = float(np.mean(reached))
        elif times:
            document.omissions.append(f"{target} dB: reached on {len(reached)} of {len(times)} recordings")


def times_to(rows: Sequence[dict], method: str, target_db: float) -> list[float | None]:
    """Return, for each recording of a method, the first second any run of it reached a level; None where none did."""
    reached: dict[tuple[str, int], list[float]] = {}
    for row in (r for r in rows if r["method"] == method):
        seconds = [p["seconds"] for p in row["curve"] if p.get("psnr_db", -np.inf) >= target_db]
        reached.setdefault((row["scene"], row["seed"]), []).extend(seconds)
    return [min(seconds, default=None) for seconds in reached.values()]


def _margins(document: BenchDocument) -> None:
    """Add how far the engine lies above the floor on its worst scene, below clean images and above 4DGS."""
    _, floor = FLOORS
    for effort in BUDGETS:
        rows = _rows(document, m.AUTO.name, effort.label)
        if rows:
            least = min(r["psnr_db"] - r[f"{floor}.psnr_db"] for r in rows)
            document.summary[f"margin.floor@{effort.label}"] = float(least)
        if effort is LONGEST:
            scores = [f"{name}.{metric}" for name in FLOORS for metric in ("psnr_db", "dynamic_psnr_db")]
            document.summary |= means(rows, scores)
    for other, sign, effort in MARGINS:
        found = gaps(document.rows, m.AUTO.name, other.name, effort.label)
        if found:
            document.summary[f"margin.{other.name}@{effort.label}"] = sign * float(np.mean(found))
