"""Computes the named numbers of a protocol's runs: means over recordings, and distances of pairs."""

from collections.abc import Sequence

from acquisition.bench_document import BenchDocument
from reconstruction.bench.conventions import means, named
from reconstruction.bench.paper.method import Protocol

AVERAGED = ("psnr_db", "ssim", "dynamic_psnr_db", "abs_rel", "dynamic_abs_rel", "delta_1_25", "seconds", "steps_per_s")


def summarise(document: BenchDocument, protocol: Protocol) -> None:
    """Fill the summary with means over recordings: `table.row.metric@effort`."""
    for table in protocol.tables:
        for row in table.rows:
            cells = protocol.wanted(table, row)
            for effort in dict.fromkeys(cell.effort.label for cell in cells):
                names = {cell.name for cell in cells if cell.effort.label == effort}
                rows = [r for r in document.rows if name_of(r) in names]
                if row.method and rows:
                    whole = means(rows, [metric for metric in AVERAGED if all(metric in r for r in rows)])
                    document.summary |= named(f"{table.name}.{row.method.name}", whole, f"@{effort}")


def name_of(row: dict) -> str:
    """Return the name of the cell that a row is of."""
    return f"{row['scene']}-{row['seed']}-{row['method']}-{row['effort']}"


def gaps(rows: Sequence[dict], one: str, other: str, effort: str, score: str = "psnr_db") -> list[float]:
    """Return how many dB a method lies above another on each recording that both have at an effort.

    Rows of unlike processors are not compared (decision 85).
    """
    own = [row for row in rows if row["effort"] == effort and score in row]
    levels = {(r["method"], r["scene"], r["seed"], r.get("processor")): r[score] for r in own}
    ones = {key[1:]: level for key, level in levels.items() if key[0] == one}
    return [level - levels[other, *key] for key, level in ones.items() if (other, *key) in levels]


def lengths(rows: Sequence[dict]) -> list[list[dict]]:
    """Return the same runs grouped by length."""
    return [[r for r in rows if r["effort"] == effort] for effort in dict.fromkeys(r["effort"] for r in rows)]
