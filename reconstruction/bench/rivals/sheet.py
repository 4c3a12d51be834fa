"""Draws the ends of runs of ours and its rivals: movers of the held-out view, enlarged, with their differences."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from reconstruction.bench.contact_sheet import write_sheet
from reconstruction.bench.conventions import HOLDOUT, KnownRecording
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.run import Laboratory
from reconstruction.bench.rivals.bench import OURS_STG, ROWS, SHORT
from reconstruction.bench.speed.mover_sheet import mover_strips
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import load_cloud

SHOWN = (m.AUTO, OURS_STG, m.TFI["stg"], m.TFI["4dgs"])


def write_rivals_sheet(path: Path, laboratory: Laboratory, scenes: Iterable[str]) -> None:
    """Write two strips for each scene of which the laboratory has kept all runs of a minute; no file for no scene."""
    strips = []
    for scene in scenes:
        cells = {row.label: row.method.on(scene, SHORT) for row in ROWS if row.method in SHOWN}
        if all(laboratory.kept(cell) for cell in cells.values()):
            runs = laboratory.runs(cells.values())
            images = {label: _held_out(*found) for label, found in zip(cells, runs, strict=True)}
            strips += mover_strips(runs[0][0], images)
    if strips:
        write_sheet(path, strips)


def _held_out(clip: KnownRecording, run: RunFolder) -> NDArray[np.float32]:
    """Return the held-out view [H, W] of a run at the middle of the truth, in spikes per tick."""
    instant_s = clip.recording.rig.clock.instant_s(clip.middle.plane)
    return load_cloud(run.snapshots()[-1]).look(clip.rig.camera(HOLDOUT), instant_s).intensity
