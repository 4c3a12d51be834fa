"""Finds where the training cameras stand, or leaves them where the rig file has them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.calibration.projection import bends_of
from reconstruction.errors import GeometryError
from reconstruction.initialization.initialisers import INITIALISERS, InitOptions
from reconstruction.pipeline import artefacts
from reconstruction.pipeline.other_points import Found
from reconstruction.run.configuration import FOUND
from reconstruction.run.decisions import Decision
from reconstruction.run.folder import RunFolder
from rigs.lens import shortened
from rigs.rig import Rig

REFINE_SD_DEG = 0.02  # degrees of doubt in a rotation above which training refines the poses: an eighth of a pixel


def poses_stage(run: RunFolder, recording: Recording, progress: Progress) -> None:
    """Find the training cameras where the plan says so; what `auto` cannot trust is refused, and the nominal rig kept.

    Reads the training cameras alone; the held-out one keeps its nominal pose and gets the focal factor found. Raises
    GeometryError where a method that was asked for by name finds no cameras to trust.
    """
    init = run.plan.init
    options = InitOptions(run.config.seed, run.config.dust3r_checkpoint)
    try:
        found = INITIALISERS[init](recording, run.plan.views, options, progress)
    except GeometryError as error:
        if run.config.init != "auto":
            raise
        run.document.poses = {"init": "sweep", "refused": str(error), "held_out_used": False}
        run.amend("poses", Decision("poses", "nominal, as given", str(error), "--init"), init="sweep")
        _refine(run, "they are nominal")
        progress(1.0, f"nominal poses kept: {error}")
        return
    if run.plan.points == FOUND:
        artefacts.write(run, artefacts.FOUND_POINTS, Found.of(found))
    if found.rig is recording.rig:
        return
    artefacts.write_rig(run.path / artefacts.FOUND_RIG, _with_shared_lens(found.rig, recording.rig, run.plan.views))
    run.document.poses = {"init": init, "held_out_used": False, **found.report}
    reason = str(found.report.get("summary", "the rig's poses are nominal"))
    run.amend("poses", Decision("poses", f"found by {init}", reason, "--init"))
    if float(found.report.get("rotation_sd_deg", 0.0)) > REFINE_SD_DEG:  # type: ignore[arg-type]
        _refine(run, f"they are known to no better than {REFINE_SD_DEG:g} degrees")


def _refine(run: RunFolder, reason: str) -> None:
    """Have training refine the poses, unless that was forbidden.

    Spans, each of which is learnt by itself, take them as they are.
    """
    if run.config.refine == "off":
        return
    if run.plan.spans:
        choice, way = "none: spans are learnt with the cameras as they are", "--span, or --refine on without spans"
        run.amend("poses", Decision("refinement", choice, f"{reason}; calibrate the rig for better ones", way))
    else:
        decision = Decision("refinement", "poses, gains and lags in training", reason, "--refine")
        run.amend("poses", decision, refine=True)


def _with_shared_lens(found: Rig, given: Rig, views: Sequence[str]) -> Rig:
    """Return the rig found, with what `views` have in common also in the cameras that were not looked at.

    That is the factor of the focal length, and the change of the lens.
    """
    pairs = [(found.camera(view), given.camera(view)) for view in views]
    factor = float(np.mean([now.fx / then.fx for now, then in pairs]))
    change = np.mean([bends_of(now) - bends_of(then) for now, then in pairs], axis=0)
    unseen = {}
    for camera in given.cameras:
        if camera.id not in views:
            own = shortened(tuple((bends_of(camera) + change).tolist())) if change.any() else camera.distortion
            unseen[camera.id] = replace(camera, fx=camera.fx * factor, fy=camera.fy * factor, distortion=own)
    return replace(found, cameras=tuple(unseen.get(c.id, c) for c in found.cameras))
