"""Measures seams: how far the error of movers jumps where one span ends and the next begins, and who is who there."""

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from reconstruction.evaluation.evaluate import HeldOut
from reconstruction.evaluation.identities import identities
from reconstruction.gaussians.spanned import SpannedScene
from reconstruction.gaussians.tracks import tracks_of
from reconstruction.pipeline.artefacts import posed, recording_of
from reconstruction.pipeline.judged import Trained, judged
from reconstruction.run.folder import RunFolder
from reconstruction.truth import Truth
from rigs.rig import object_distance_m


def finished(path: Path) -> Trained | None:
    """Return the finished run in `path` beside its truth; None where its recording has none."""
    run = RunFolder.open(path)
    recording = posed(run, recording_of(run), refined=True)
    return judged(run, recording, Truth.open(recording.truth)) if recording.truth else None


def measured_seams(trained: Trained) -> dict[str, float]:
    """Return what there is to say of the seams of a finished run; nothing without spans or truth.

    `seam_ratio`: by how much more the error steps at seams than within spans. A step is the root mean square, over
    pixels that move, of the change of render minus truth from one instant of truth to the next. `followed`: how often
    a body was followed across a seam. `switched`: how often it was another object then.
    """
    if not isinstance(trained.cloud, SpannedScene) or trained.held_out is None or trained.truth is None:
        return {}
    at_seams, within = steps_of_error(trained.cloud, trained.held_out, trained.truth)
    ratio = {"seam_ratio": float(np.mean(at_seams) / np.mean(within))} if at_seams and within else {}
    rig = trained.recording.rig
    tracks = tracks_of(trained.cloud, object_distance_m(rig.cameras))
    found = identities(tracks, trained.cloud, trained.camera, trained.truth, rig.clock)
    return {**ratio, "followed": found.followed, "switched": found.switched}


def steps_of_error(scene: SpannedScene, held_out: HeldOut, truth: Truth) -> tuple[list[float], list[float]]:
    """Return the steps of the error over all instants of truth, in spikes per tick: those at seams, and the others."""
    at_seams: list[float] = []
    within: list[float] = []
    looks = (_look(scene, held_out, truth, plane) for plane in truth.planes(held_out.camera.id))
    for (span, gap, moving), (next_span, next_gap, next_moving) in pairwise(looks):
        either = moving | next_moving
        if either.any():
            step = float(np.sqrt(np.mean(np.square(next_gap - gap)[either])))
            (within if span == next_span else at_seams).append(step)
    return at_seams, within


def _look(
    scene: SpannedScene, held_out: HeldOut, truth: Truth, plane: int
) -> tuple[int, NDArray[np.float32], NDArray[np.bool_]]:
    """Return the span that a plane lies in, render minus truth [H, W] there, and the pixels [H, W] that move."""
    instant_s = held_out.recording.rig.clock.instant_s(plane - truth.lag_ticks)
    frame = truth.frame(held_out.camera.id, plane)
    shown = scene.look(held_out.camera, instant_s).intensity
    return scene.number_at(instant_s), shown - frame.intensity, frame.moving
