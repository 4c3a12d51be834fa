"""The whole catalogue on everything this machine has, as the document `spike4dgs stability --json` prints."""

from collections.abc import Callable
from dataclasses import asdict

from reconstruction.stability import cameras, images, losses, motion, recordings, rendering
from reconstruction.stability.case import Case, row_of
from reconstruction.stability.probe import omissions

_SUBJECTS = (rendering, motion, losses, images, recordings, cameras)
CASES: tuple[Case, ...] = tuple(sorted((c for m in _SUBJECTS for c in m.CASES), key=lambda case: case.number or 0))


def run_catalogue(progress: Callable[[float, str], None]) -> dict:
    """`rows`, a `summary` of how many there are and how many failed, and the `omissions` with their reasons."""
    rows = []
    for done, case in enumerate(CASES):
        progress(done / len(CASES), case.name)
        rows += [row_of(case, backend) for backend in case.on()]
    return {
        "rows": [asdict(row) for row in rows],
        "omissions": omissions(),
        "summary": {"cases": len(rows), "failed": sum(row.verdict == "fail" for row in rows)},
    }
