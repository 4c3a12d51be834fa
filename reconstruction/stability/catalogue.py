"""Runs the whole catalogue on everything this machine has, for the document of `spike4dgs stability --json`."""

import math
import tempfile
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from acquisition.bench_document import BenchDocument
from acquisition.progress import Progress, part
from reconstruction.stability import (
    averages,
    cameras,
    dimness,
    expectations,
    images,
    lenses,
    limits,
    losses,
    marching,
    motion,
    parts,
    pixels,
    recordings,
    rendering,
    spans,
)
from reconstruction.stability.case import Case, Row, row_of
from reconstruction.stability.drift import drift_cases
from reconstruction.stability.probe import omissions
from reconstruction.stability.stiff import FULL, Extent, StiffScene, curves, stiff_cases

_SUBJECTS = (
    *(rendering, motion, losses, expectations, images, recordings),
    *(cameras, marching, dimness, pixels, lenses, spans, averages, limits, parts),
)
_ALL = (case for subject in _SUBJECTS for case in subject.CASES)
CASES: tuple[Case, ...] = tuple(sorted(_ALL, key=lambda case: case.number or math.inf))


@dataclass(frozen=True)
class LongRuns:
    """The runs that take minutes: `ticks` of drift, and trainings on the stiff scenes."""

    ticks: int = 10_000_000
    trainings: Extent = FULL


def run_catalogue(progress: Progress, long_runs: LongRuns | None = None) -> dict:
    """Run every case and return the document; `summary` has the number of rows, and of those that failed.

    With `long_runs` there are more rows, and `curves`: the losses of every step in float32 and float64, by scene.
    """
    rows, shown = _rows(CASES, part(progress, 0.0, 0.1 if long_runs else 1.0)), {}
    if long_runs:
        drifting = part(progress, 0.1, 0.2)
        rows += _rows(drift_cases(long_runs.ticks, lambda _, said: drifting(0.0, said)), drifting)
        stiff, shown = _stiff(long_runs.trainings, part(progress, 0.2, 1.0))
        rows += stiff
    failed = sum(row.verdict == "fail" for row in rows)
    document = BenchDocument("stability", [asdict(row) for row in rows], omissions())
    document.summary = {"cases": len(rows), "failed": failed}
    return document.to_json() | ({"curves": shown} if long_runs else {})


def _rows(cases: Iterable[Case], progress: Progress) -> list[Row]:
    work = [(case, backend) for case in cases for backend in case.on()]
    rows = []
    for done, (case, backend) in enumerate(work):
        progress(done / len(work), f"{case.name}, {backend}")
        rows.append(row_of(case, backend))
    progress(1.0, f"{len(rows)} rows")
    return rows


def _stiff(extent: Extent, progress: Progress) -> tuple[list[Row], dict]:
    """Return the rows and the curves of every scene, recorded and trained in a folder that is removed."""
    rows, shown, count = [], {}, len(extent.planes)
    with tempfile.TemporaryDirectory() as folder:
        for number, name in enumerate(extent.planes):
            scene = StiffScene(name, Path(folder), extent)
            rows += _rows(stiff_cases(scene), part(progress, number / count, (number + 1) / count))
            shown[name] = curves(scene)
    return rows, shown
