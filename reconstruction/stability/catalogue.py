"""The whole catalogue on everything this machine has, as the document `spike4dgs stability --json` prints."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from acquisition.bench_document import device
from acquisition.progress import Progress
from acquisition.revision import code_revision
from reconstruction.stability import cameras, images, losses, marching, motion, recordings, rendering
from reconstruction.stability.case import Case, Row, row_of
from reconstruction.stability.drift import drift_cases
from reconstruction.stability.probe import omissions
from reconstruction.stability.stiff import FULL, Extent, StiffScene, curves, stiff_cases

_SUBJECTS = (rendering, motion, losses, images, recordings, cameras, marching)
_ALL = (case for subject in _SUBJECTS for case in subject.CASES)
CASES: tuple[Case, ...] = tuple(sorted(_ALL, key=lambda case: case.number or math.inf))


@dataclass(frozen=True)
class LongRuns:
    """What takes minutes: so many ticks of drift, and trainings on the stiff scenes."""

    ticks: int = 10_000_000
    trainings: Extent = FULL


def run_catalogue(progress: Progress, long_runs: LongRuns | None = None) -> dict:
    """`rows`, a `summary` of how many there are and how many failed, and the `omissions` with their reasons.

    `device` and `revision` say where and of what.

    With `long_runs` more rows, and the `curves`: losses of every step in float32 and float64, by scene.
    """
    rows, shown = _rows(CASES, _part(progress, 0.0, 0.1 if long_runs else 1.0)), {}
    if long_runs:
        rows += _drift(long_runs.ticks, _part(progress, 0.1, 0.2))
        stiff, shown = _stiff(long_runs.trainings, _part(progress, 0.2, 1.0))
        rows += stiff
    return {
        "device": device(),
        "revision": code_revision(),
        "rows": [asdict(row) for row in rows],
        "omissions": omissions(),
        "summary": {"cases": len(rows), "failed": sum(row.verdict == "fail" for row in rows)},
        **({"curves": shown} if long_runs else {}),
    }


def _rows(cases: Iterable[Case], progress: Progress) -> list[Row]:
    work = [(case, backend) for case in cases for backend in case.on()]
    rows = []
    for done, (case, backend) in enumerate(work):
        progress(done / len(work), f"{case.name}, {backend}")
        rows.append(row_of(case, backend))
    progress(1.0, f"{len(rows)} rows")
    return rows


def _drift(ticks: int, progress: Progress) -> list[Row]:
    return _rows(drift_cases(ticks, lambda _, said: progress(0.0, said)), progress)


def _stiff(extent: Extent, progress: Progress) -> tuple[list[Row], dict]:
    """The rows and the curves of every scene, recorded and trained in a folder that goes away."""
    rows, shown = [], {}
    with tempfile.TemporaryDirectory() as folder:
        for number, name in enumerate(extent.planes):
            scene = StiffScene(name, Path(folder), extent)
            share = len(extent.planes)
            rows += _rows(stiff_cases(scene), _part(progress, number / share, (number + 1) / share))
            shown[name] = curves(scene)
    return rows, shown


def _part(progress: Progress, first: float, last: float) -> Progress:
    """Report a part of the work as [first, last] of the whole."""
    return lambda done, said: progress(first + done * (last - first), said)
