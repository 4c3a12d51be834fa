"""The whole catalogue on every backend of this machine, as the document `spike4dgs stability --json` prints."""

from collections.abc import Callable
from dataclasses import asdict

from reconstruction.rendering.gsplat_backend import why_unavailable
from reconstruction.stability import losses, rendering
from reconstruction.stability.case import Case, Row, row_of
from reconstruction.stability.probe import backends

CASES: tuple[Case, ...] = (*rendering.CASES, *losses.CASES)


def run_catalogue(progress: Callable[[float, str], None]) -> dict:
    """`rows`, a `summary` of how many there are and how many failed, and the `omissions` with their reasons."""
    rows: list[Row] = []
    for done, case in enumerate(CASES):
        progress(done / len(CASES), case.name)
        rows += [row_of(case, backend) for backend in (backends() if case.renders else backends()[:1])]
    missing = why_unavailable()
    return {
        "rows": [asdict(row) for row in rows],
        "omissions": [f"gsplat: {missing}"] if missing else [],
        "summary": {"cases": len(rows), "failed": sum(row.verdict == "fail" for row in rows)},
    }
