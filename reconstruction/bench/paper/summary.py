"""Computes the named numbers of the paper bench: means over recordings, margins over the rivals, times to levels."""

from collections.abc import Iterable, Sequence

import numpy as np

from acquisition.bench_document import BenchDocument
from acquisition.scenes.catalog import STRESS
from reconstruction.bench.conventions import means, named
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.method import Protocol

AVERAGED = ("psnr_db", "ssim", "dynamic_psnr_db", "abs_rel", "dynamic_abs_rel", "delta_1_25", "seconds", "steps_per_s")
MARGINS = {"tfi+4dgs-small": 1, "dy-spikegs": 1, "clean": -1}  # ours less theirs; for the bound, theirs less ours
RIVALS = tuple(method.name for method in (*m.TFI.values(), *m.SPIKES.values()))  # same poses, from spikes
TARGETS_DB = (25, 27, 28, 30)


def summarise(document: BenchDocument, protocol: Protocol) -> None:
    """Fill the summary: `table.row.metric@effort`, `margin.rival@effort` and `seconds_to_*`."""
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
    add_times_to(document, rows, TARGETS_DB)


def add_times_to(document: BenchDocument, rows: Sequence[dict], targets_db: Sequence[int]) -> None:
    """Add the mean over recordings of the first second at which ours reached each level, or name those that did not."""
    for target in targets_db:
        times = times_to(rows, m.AUTO.name, target)
        reached = [t for t in times if t is not None]
        if reached and len(reached) == len(times):
            document.summary[f"{m.AUTO.name}.seconds_to_{target}"] = float(np.mean(reached))
        elif times:
            document.omissions.append(f"{target} dB: reached on {len(reached)} of {len(times)} recordings")


def ordinary(rows: Iterable[dict]) -> list[dict]:
    """Return the rows of scenes that are not there for one difficulty."""
    return [row for row in rows if row["scene"] not in STRESS]


def name_of(row: dict) -> str:
    """Return the name of the cell that a row is of."""
    return f"{row['scene']}-{row['seed']}-{row['method']}-{row['effort']}"


def gaps(rows: Sequence[dict], one: str, other: str, effort: str, score: str = "psnr_db") -> list[float]:
    """Return how many dB a method lies above another on each recording that both have at an effort."""
    own = [row for row in rows if row["effort"] == effort and score in row]
    levels = {(r["method"], r["scene"], r["seed"]): r[score] for r in own}
    ones = {key[1:]: level for key, level in levels.items() if key[0] == one}
    return [level - levels[other, *key] for key, level in ones.items() if (other, *key) in levels]


def widest(rows: Sequence[dict]) -> list[dict]:
    """Return the runs of the length that most scenes were run at, the longest one of several."""
    return max(lengths(rows), key=lambda own: (len({r["scene"] for r in own}), max(r["seconds"] for r in own)))


def lengths(rows: Sequence[dict]) -> list[list[dict]]:
    """Return the same runs grouped by length."""
    return [[r for r in rows if r["effort"] == effort] for effort in dict.fromkeys(r["effort"] for r in rows)]


def times_to(rows: Sequence[dict], method: str, target_db: float) -> list[float | None]:
    """Return, for each recording of a method, the first second any run of it reached a level; None where none did."""
    reached: dict[tuple[str, int], list[float]] = {}
    for row in (r for r in rows if r["method"] == method):
        seconds = [p["seconds"] for p in row["curve"] if p.get("psnr_db", -np.inf) >= target_db]
        reached.setdefault((row["scene"], row["seed"]), []).extend(seconds)
    return [min(seconds, default=None) for seconds in reached.values()]
