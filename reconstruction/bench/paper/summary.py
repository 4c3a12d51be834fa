"""Computes the named numbers of the paper bench: means over recordings, margins over the rivals, times to levels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from acquisition.bench_document import BenchDocument
from acquisition.scenes.catalog import STRESS
from reconstruction.bench.conventions import means, named
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.method import Protocol

AVERAGED = ("psnr_db", "ssim", "dynamic_psnr_db", "abs_rel", "dynamic_abs_rel", "delta_1_25", "seconds", "steps_per_s")
MARGINS = {"tfi+4dgs": 1, "dy-spikegs": 1, "clean": -1}  # ours less theirs; for the bound, theirs less ours
RIVALS = tuple(method.name for method in (*m.TFI.values(), *m.SPIKES.values()))  # same poses, from spikes
LEAD_S = 15.0  # seconds from which on curves are compared
TARGETS_DB = (25, 27, 28, 30)


def summarise(document: BenchDocument, protocol: Protocol) -> None:
    """Fill the summary: `table.row.metric@effort`, `margin.rival@effort`, `leads.*` and `seconds_to_*`."""
    for table in protocol.tables:
        for row in table.rows:
            cells = protocol.wanted(table, row)
            for effort in dict.fromkeys(cell.effort.label for cell in cells):
                names = {cell.name for cell in cells if cell.effort.label == effort}
                rows = [r for r in document.rows if name_of(r) in names]
                if row.method and rows:
                    whole = means(rows, [metric for metric in AVERAGED if all(metric in r for r in rows)])
                    document.summary |= named(f"{table.name}.{row.method.name}", whole, f"@{effort}")
    rows = ordinary(document.rows)
    for effort in dict.fromkeys(r["effort"] for r in document.rows):
        for rival, sign in MARGINS.items():
            found = gaps(rows, m.AUTO.name, rival, effort)
            if found:
                document.summary[f"margin.{rival}@{effort}"] = sign * float(np.mean(found))
    document.summary |= leads(rows)
    for target in TARGETS_DB:
        reached = times_to(rows, m.AUTO.name, target)
        if reached and None not in reached:
            seconds = float(np.mean([t for t in reached if t is not None]))
            document.summary[f"{m.AUTO.name}.seconds_to_{target}"] = seconds


def ordinary(rows: Iterable[dict]) -> list[dict]:
    """Return the rows of scenes that are not there for one difficulty."""
    return [row for row in rows if row["scene"] not in STRESS]


def name_of(row: dict) -> str:
    """Return the name of the cell that a row is of."""
    return f"{row['scene']}-{row['seed']}-{row['method']}-{row['effort']}"


def gaps(rows: Sequence[dict], one: str, other: str, effort: str) -> list[float]:
    """Return how many dB a method lies above another on each recording that both have at an effort."""
    levels = {(r["method"], r["scene"], r["seed"]): r["psnr_db"] for r in rows if r["effort"] == effort}
    ones = {key[1:]: level for key, level in levels.items() if key[0] == one}
    return [level - levels[other, *key] for key, level in ones.items() if (other, *key) in levels]


def leads(rows: Sequence[dict]) -> dict[str, float]:
    """Return the number of points of the rivals' curves from LEAD_S on, and at how many ours is behind, by metric.

    Ours at a time is the latest snapshot of any of its runs of that recording by then. The points compare schedules of
    different lengths: a rival in the middle of a long run may stand against a finished short run of ours.
    """
    found: dict[str, float] = {}
    for metric, better in (("psnr_db", max), ("abs_rel", min)):
        pairs = list(_paired(rows, metric))
        if pairs:
            found[f"leads.{metric}.points"] = len(pairs)
            found[f"leads.{metric}.behind"] = sum(better(level, ours) != ours for level, ours in pairs)
    return found


def _paired(rows: Sequence[dict], metric: str) -> Iterator[tuple[float, float]]:
    """Yield every point of a rival from LEAD_S on, with the latest snapshot of ours on the same recording by then."""
    for recording in dict.fromkeys((r["scene"], r["seed"]) for r in rows):
        here = [r for r in rows if (r["scene"], r["seed"]) == recording]
        ours = curve((r for r in here if r["method"] == m.AUTO.name), metric)
        for seconds, level in curve((r for r in here if r["method"] in RIVALS), metric):
            shown = [y for x, y in ours if x <= seconds]
            if seconds >= LEAD_S and shown:
                yield level, shown[-1]


def curve(rows: Iterable[dict], metric: str = "psnr_db") -> list[tuple[float, float]]:
    """Return the seconds and levels of all snapshots of some runs, in order of time."""
    return sorted((p["seconds"], p[metric]) for r in rows for p in r["curve"] if metric in p)


def widest(rows: Sequence[dict]) -> list[dict]:
    """Return the runs of the length that most scenes were run at, the longest one of several."""
    return max(lengths(rows), key=lambda own: (len({r["scene"] for r in own}), max(r["seconds"] for r in own)))


def lengths(rows: Sequence[dict]) -> list[list[dict]]:
    """Return the same runs grouped by length."""
    return [[r for r in rows if r["effort"] == effort] for effort in dict.fromkeys(r["effort"] for r in rows)]


def times_to(rows: Sequence[dict], method: str, target_db: float) -> list[float | None]:
    """Return, for each recording of a method, the first second any run of it reached a level; None where none did."""
    curves: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for row in (r for r in rows if r["method"] == method):
        curves.setdefault((row["scene"], row["seed"]), []).extend(curve([row]))
    return [min((t for t, level in points if level >= target_db), default=None) for points in curves.values()]
