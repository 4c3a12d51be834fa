"""Runs every cell of a protocol by priority, for as long as there is time."""

import time
from collections.abc import Callable, Iterable, Mapping

from acquisition.bench_document import BenchDocument
from acquisition.errors import AcquisitionError
from acquisition.progress import Progress
from reconstruction.bench.paper.method import Protocol
from reconstruction.bench.paper.run import Laboratory
from reconstruction.bench.paper.summary import name_of, summarise
from rigs.errors import Spike4dgsError

NOT_RUN = "not run yet"
UNPRINTED = "The table still lacks runs, and is not printed."
OVERRUN = 0.1  # share of the budget beyond which an omission names the run
NOTES = (
    "BRISQUE and NIQE: their parameters are not shipped; where the paper has only them, ours is PSNR",
    "the paper's real recordings: not public; and its CARLA scenes: not public, so its figures are of other scenes",
    "points: those of our plane sweep where a row names no others, also where the paper has those of COLMAP or DUSt3R",
    "COLMAP is given long-window images in every row; on TFI images of one instant it is in `bench poses`",
)


def lacks_runs(omissions: Iterable[str], table: str = "") -> bool:
    """Tell whether runs are left to be made, of one table or of any."""
    return any(NOT_RUN in line and (not table or line.startswith(f"{table}, ")) for line in omissions)


def timer(limit_s: float | None, now: Callable[[], float] = time.monotonic) -> Callable[[], bool]:
    """Return a function that tells whether there is time left, counted from now on; None is no limit."""
    began = now()
    return lambda: limit_s is None or now() - began < limit_s


def bench_paper(
    protocol: Protocol, laboratory: Laboratory, progress: Progress, time_left: Callable[[], bool] = lambda: True
) -> BenchDocument:
    """Run the protocol of the paper, and return its rows, omissions and summary."""
    document = run_protocol("paper", protocol, laboratory, progress, time_left)
    document.omissions += NOTES
    summarise(document, protocol)
    return document


def run_protocol(
    name: str,
    protocol: Protocol,
    laboratory: Laboratory,
    progress: Progress,
    time_left: Callable[[], bool] = lambda: True,
) -> BenchDocument:
    """Run the cells that have no result yet, the most wanted first, and return the document of that name.

    Without `time_left` no cell is begun. A cell that is not begun has the row of an earlier document, by whatever code.
    Cells that were refused or left out stand in the omissions; one whose recording cannot be made is not run. The
    summary is empty.
    """
    document, unmade = BenchDocument(name), {}
    cells, begins = protocol.cells(), protocol.begins()
    for number, cell in enumerate(cells):
        progress(number / len(cells), cell.name)
        try:
            found = laboratory.known(cell)
            if found is None:
                begun = cell.name in begins and time_left()
                found = laboratory.result(cell) if begun else laboratory.older(cell)
        except AcquisitionError as failure:
            found, unmade[cell.name] = None, f"{NOT_RUN}, {_line(failure)}"
        except Spike4dgsError as refusal:
            found, unmade[cell.name] = None, _line(refusal)
        if found:
            (document.refused if "refused" in found else document.rows).append(found)
    _omissions(document, protocol, unmade | {name_of(row): row["refused"] for row in document.refused})
    progress(1.0, f"{len(document.rows)} of {len(cells)} runs")
    return document


def _line(error: Exception) -> str:
    return " ".join(str(error).split())


def _omissions(document: BenchDocument, protocol: Protocol, refusals: Mapping[str, str]) -> None:
    """Name every row of a table that lacks runs, with the reason and the recordings."""
    have = {name_of(row) for row in document.rows}
    for table in protocol.tables:
        for row in table.rows:
            if row.omitted:
                document.omissions.append(f"{table.name}, {row.label}: {row.omitted}")
            places: dict[str, list[str]] = {}
            for cell in (c for c in protocol.wanted(table, row) if c.name not in have):
                where = f"{cell.scene}-{cell.seed} @{cell.effort.label}"
                places.setdefault(refusals.get(cell.name, NOT_RUN), []).append(where)
            for reason, found in places.items():
                document.omissions.append(f"{table.name}, {row.label}: {reason} ({', '.join(found)})")
    for row in document.rows:
        if row["budget_s"] is not None and row["seconds"] > (1 + OVERRUN) * row["budget_s"]:
            took = f"took {row['seconds']:.0f} s: the stages before training left no time for it"
            document.omissions.append(f"{name_of(row)}: {took}")
    others = sorted({r["revision"] for r in (*document.rows, *document.refused) if r.get("kept")})
    if others:
        document.omissions.append(f"kept from other code, at the revisions {', '.join(others)}")
