"""Opens a run folder as the formats of `export` want it."""

from dataclasses import replace

from acquisition.recording.reader import Recording
from reconstruction.errors import BadRunError
from reconstruction.export.scene import Scene
from reconstruction.pipeline.artefacts import posed, read_held_out, read_white, recording_of
from reconstruction.pipeline.evidence_artefact import read_uncertainty
from reconstruction.pipeline.span_artefacts import read_recorded_targets
from reconstruction.run.folder import RunFolder
from reconstruction.scene_model import SceneModel
from reconstruction.training.checkpoint import load_cloud


def scene_of(run: RunFolder, recording: Recording, cloud: SceneModel) -> Scene:
    """Return `cloud` with the cameras of `recording`, those that the run ended with.

    A held-out camera that was placed by its spikes stands where the report placed it.
    """
    targets = lambda: read_recorded_targets(run, recording)  # noqa: E731
    rig, placed = recording.rig, read_held_out(run)
    if placed is not None:
        rig = replace(rig, cameras=tuple(placed if c.id == placed.id else c for c in rig.cameras))
    model, holdout, uncertainty = run.plan.model, run.config.holdout, read_uncertainty(run, cloud)
    return Scene(cloud, rig, read_white(run), model, holdout, targets, uncertainty=uncertainty)


def trained_scene(run: RunFolder) -> Scene:
    """Return what a run has learnt; raises BadRunError for one whose training has not ended."""
    if not run.has("train"):
        raise BadRunError("found no finished train stage", "a trained run", "finish it first", where=run.path)
    return scene_of(run, posed(run, recording_of(run), refined=True), load_cloud(run.checkpoint))
