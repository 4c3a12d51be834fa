"""The named numbers of the bench: means over recordings, margins over the rivals, and whether any is ahead."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from acquisition.bench_document import BenchDocument
from acquisition.scenes.catalog import STRESS
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.method import Protocol

AVERAGED = ("psnr_db", "ssim", "dynamic_psnr_db", "abs_rel", "dynamic_abs_rel", "delta_1_25", "seconds", "steps_per_s")
MARGINS = {"tfi+4dgs": 1, "dy-spikegs": 1, "clean": -1}  # ours less theirs; for the bound, theirs less ours
RIVALS = (*(method.name for method in (*m.TFI.values(), *m.SPIKES.values())),)  # with the same poses, from spikes
LEAD_S = 15.0  # from when on ours is to lead
TARGETS_DB = (25, 27, 28, 30)


def summarise(document: BenchDocument, protocol: Protocol) -> None:
    """Fill the summary: `table.row.metric@effort`, `margin.rival@effort`, `leads.*` and `seconds_to_*`."""
    for table in protocol.tables:
        for row in table.rows:
            cells = protocol.wanted(table, row)
            for effort in dict.fromkeys(cell.effort.label for cell in cells):
                names = {cell.name for cell in cells if cell.effort.label == effort}
                rows = [r for r in document.rows if name_of(r) in names]
                for metric in AVERAGED:
                    if row.method and rows and all(metric in r for r in rows):
                        key = f"{table.name}.{row.method.name}.{metric}@{effort}"
                        document.summary[key] = float(np.mean([r[metric] for r in rows]))
    for effort in dict.fromkeys(r["effort"] for r in document.rows):
        for rival, sign in MARGINS.items():
            found = gaps(ordinary(document.rows), m.AUTO.name, rival, effort)
            if found:
                document.summary[f"margin.{rival}@{effort}"] = sign * float(np.mean(found))
    document.summary |= leads(ordinary(document.rows))
    for target in TARGETS_DB:
        reached = times_to(ordinary(document.rows), m.AUTO.name, target)
        if reached and None not in reached:
            document.summary[f"{m.AUTO.name}.seconds_to_{target}"] = float(
                np.mean([t for t in reached if t is not None])
            )


def ordinary(rows: Iterable[dict]) -> list[dict]:
    """Those of scenes that are not there for one difficulty."""
    return [row for row in rows if row["scene"] not in STRESS]


def name_of(row: dict) -> str:
    """The name of the cell that a row is of."""
    return f"{row['scene']}-{row['seed']}-{row['method']}-{row['effort']}"


def gaps(rows: Sequence[dict], one: str, other: str, effort: str) -> list[float]:
    """How many dB a method lies above another on each recording that both have at an effort."""
    levels = {(r["method"], r["scene"], r["seed"]): r["psnr_db"] for r in rows if r["effort"] == effort}
    ones = {key[1:]: level for key, level in levels.items() if key[0] == one}
    return [level - levels[other, *key] for key, level in ones.items() if (other, *key) in levels]


def leads(rows: Sequence[dict]) -> dict[str, float]:
    """How many points the rivals' curves have from LEAD_S on, and at how many of them ours is behind, by metric.

    Zero where ours leads at every time. Ours is what any of its runs of that recording had come to last by then, not
    the best that one had shown: who stops a run has what it has come to.
    """
    found: dict[str, float] = {}
    for metric, better in (("psnr_db", max), ("abs_rel", min)):
        pairs = list(_held(rows, metric))
        if pairs:
            found[f"leads.{metric}.points"] = len(pairs)
            found[f"leads.{metric}.behind"] = sum(better(level, ours) != ours for level, ours in pairs)
    return found


def _held(rows: Sequence[dict], metric: str) -> Iterator[tuple[float, float]]:
    """Every point of a rival from LEAD_S on, and what ours had come to on the same recording by then."""
    for recording in dict.fromkeys((r["scene"], r["seed"]) for r in rows):
        here = [r for r in rows if (r["scene"], r["seed"]) == recording]
        ours = curve((r for r in here if r["method"] == m.AUTO.name), metric)
        for seconds, level in curve((r for r in here if r["method"] in RIVALS), metric):
            shown = [y for x, y in ours if x <= seconds]
            if seconds >= LEAD_S and shown:
                yield level, shown[-1]


def curve(rows: Iterable[dict], metric: str = "psnr_db") -> list[tuple[float, float]]:
    """Seconds and levels of all snapshots of some runs, in order of time."""
    return sorted((p["seconds"], p[metric]) for r in rows for p in r["curve"] if metric in p)


def widest(rows: Sequence[dict]) -> list[dict]:
    """The runs of the length that most scenes were run at, of the longest such."""
    return max(lengths(rows), key=lambda own: (len({r["scene"] for r in own}), max(r["seconds"] for r in own)))


def lengths(rows: Sequence[dict]) -> list[list[dict]]:
    """The same runs, those of one length together."""
    return [[r for r in rows if r["effort"] == effort] for effort in dict.fromkeys(r["effort"] for r in rows)]


def times_to(rows: Sequence[dict], method: str, target_db: float) -> list[float | None]:
    """For each recording a method was run on, the first second any run of it reached a level; None where none did."""
    curves: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for row in (r for r in rows if r["method"] == method):
        curves.setdefault((row["scene"], row["seed"]), []).extend(curve([row]))
    return [min((t for t, level in points if level >= target_db), default=None) for points in curves.values()]
