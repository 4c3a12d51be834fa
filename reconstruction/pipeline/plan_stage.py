"""Decides what the scene needs."""

from dataclasses import replace

import numpy as np

from acquisition.progress import Progress
from acquisition.recording.manifest import CameraFile
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
    said = filter(None, (_cut_off(run, recording), _lost(run, recording)))
    if warning := "; ".join(said):
        run.document.warnings["plan"] = warning
    progress(1.0, "\n".join(map(str, plan.decisions)))


def _cut_off(run: RunFolder, recording: Recording) -> str:
    """Return what to say where a camera that was cut off before others ends what is reconstructed, or nothing."""
    first, last = (choose(_read(run, recording), key=lambda entry: entry.planes) for choose in (min, max))
    if not recording.ticks.stop == first.first_tick + first.planes < last.first_tick + last.planes:
        return ""
    return (
        f"{first.id} ends at tick {recording.ticks.stop - 1}, where others go on to tick "
        f"{last.first_tick + last.planes - 1}: name the others by --views, or the rest is not reconstructed"
    )


def _lost(run: RunFolder, recording: Recording) -> str:
    """Return what to say where planes of a camera were lost, or nothing: they are zeros, and count as darkness."""
    lost = {entry.id: entry.lost_within(recording.ticks) for entry in _read(run, recording)}
    named = ", ".join(f"{planes} of {camera}" for camera, planes in lost.items() if planes)
    if not named:
        return ""
    do = "leave such a training camera out by --views, or such ticks by --from-tick and --to-tick"
    return f"planes were lost, {named}, and count as darkness: {do}"


def _read(run: RunFolder, recording: Recording) -> list[CameraFile]:
    """Return the entries of the cameras that the run trains on or scores by."""
    return [entry for entry in recording.manifest.cameras if entry.id in (*run.plan.views, run.config.holdout)]
