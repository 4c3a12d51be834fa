"""Runs and draws the bench of expected errors. Imports are late, for a capture host has no torch."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.bench_document import BenchDocument
from acquisition.revision import code_revision
from acquisition.scenes.catalog import BACKGROUNDS, DEVELOPMENT, DEVELOPMENT_SEEDS, LONG_DEVELOPMENT, REALISTIC
from server.cli.bench_asked import QUICK_RIG, QUICK_TICKS, TICKS, Asked, recording

if TYPE_CHECKING:
    from reconstruction.run.folder import RunFolder

RUN_S, QUICK_S = 60.0, 5.0  # budget of a run


def uncertainty(asked: Asked) -> BenchDocument:
    """Measure expected errors on development scenes, of ours by default; with --quick, on three that are small."""
    from reconstruction.bench.conventions import KnownRecording
    from reconstruction.bench.uncertainty.bench import bench_uncertainty

    named = asked.named((*DEVELOPMENT, *LONG_DEVELOPMENT, *BACKGROUNDS, *REALISTIC))
    scenes = dict.fromkeys((*named, *LONG_DEVELOPMENT))  # any scene is judged by others that are unlike it
    ticks, rig = (QUICK_TICKS, QUICK_RIG) if asked.quick else (TICKS, None)
    seed, progress, runs = DEVELOPMENT_SEEDS[1], asked.progress_of("uncertainty"), []
    for scene in scenes:
        path = recording(scene, seed, _work(asked), ticks, rig)
        runs.append((KnownRecording(scene, seed, path), _run(asked, path, seed)))
    return bench_uncertainty(runs, REALISTIC, _sheet(asked), progress)


def draw_uncertainty(asked: Asked, out: Path, found: dict) -> None:
    """Draw the picture of a document, and write its page and the sheet of maps."""
    from reconstruction.bench.contact_sheet import stack_sheets
    from reconstruction.bench.uncertainty.page import plot_uncertainty, write_page

    plot_uncertainty(out / "uncertainty.png", found)
    write_page(out / "uncertainty.md", found)
    if _sheet(asked).exists():
        stack_sheets(out / "uncertainty-sheet.jpg", [_sheet(asked)])


def _work(asked: Asked) -> Path:
    return asked.work / "uncertainty" / "quick" if asked.quick else asked.work / "uncertainty"


def _sheet(asked: Asked) -> Path:
    return _work(asked) / "sheet.png"


def _run(asked: Asked, path: Path, seed: int) -> RunFolder:
    """Return the finished run on a recording, made unless this code has left it."""
    from reconstruction.bench.conventions import HOLDOUT
    from reconstruction.pipeline.stages import reconstruct
    from reconstruction.run.configuration import ReconstructionConfig
    from reconstruction.run.folder import RunFolder

    out = path.with_suffix(".run")
    if (out / "report.html").exists() and RunFolder.open(out).document.revision == code_revision():
        return RunFolder.open(out)
    shutil.rmtree(out, ignore_errors=True)
    config = ReconstructionConfig(holdout=HOLDOUT, budget_s=QUICK_S if asked.quick else RUN_S, seed=seed)
    return reconstruct(path, out, config, asked.progress_of)
