"""Decides what the scene needs."""

from dataclasses import replace

import numpy as np

from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.errors import BadRunError
from reconstruction.pipeline.artefacts import LIGHT, MOVING
from reconstruction.pipeline.span_artefacts import PLANNED, write_masks
from reconstruction.run.decisions import Decision
from reconstruction.run.folder import RunFolder
from reconstruction.run.plan import LEAST_WINDOW, make_plan


def plan_stage(run: RunFolder, recording: Recording, progress: Progress) -> None:
    """Make the plan, and keep the light and each training view's moving pixels.

    Raises BadRunError for too few planes, and as `make_plan`.
    """
    if recording.planes < LEAST_WINDOW:
        do = "record for longer: a plane is one bit a pixel"
        raise BadRunError(f"found {recording.planes} planes", f"at least {LEAST_WINDOW}", do, where=recording.path)
    asked = run.config.views or recording.camera_ids
    streams = {c: recording.stream(c) for c in recording.camera_ids if c in asked and c != run.config.holdout}
    plan, masks, light = make_plan(run.config, recording.rig, streams, progress)
    run.write_array(LIGHT, light.gains)
    for view, mask in masks.items():
        run.write_array(MOVING.format(view=view), np.logical_or.reduce(mask))
        if plan.spans:
            write_masks(run, PLANNED, view, mask)
    if recording.part_planes is not None:
        choice = f"ticks {recording.ticks.start} to {recording.ticks.stop - 1}"
        said = Decision(
            "part", choice, "no other plane is read; instants are those of the whole recording", "--from-tick"
        )
        plan = replace(plan, decisions=(said, *plan.decisions))
    run.document.planned, run.document.amendments = plan, []
    _warn_of_ends(run, recording)
    progress(1.0, "\n".join(map(str, plan.decisions)))


def _warn_of_ends(run: RunFolder, recording: Recording) -> None:
    """Warn in the run where a camera that was cut off before others ends what is reconstructed."""
    entries = [entry for entry in recording.manifest.cameras if entry.id in (*run.plan.views, run.config.holdout)]
    first, last = (choose(entries, key=lambda entry: entry.planes) for choose in (min, max))
    if recording.ticks.stop == first.first_tick + first.planes < last.first_tick + last.planes:
        run.document.warnings["plan"] = (
            f"{first.id} ends at tick {recording.ticks.stop - 1}, where others go on to tick "
            f"{last.first_tick + last.planes - 1}: name the others by --views, or the rest is not reconstructed"
        )
