"""A run folder as the formats of `export` want it."""

from __future__ import annotations

from acquisition.recording.reader import Recording
from reconstruction.errors import BadRunError
from reconstruction.export.scene import Scene
from reconstruction.pipeline.poses import posed
from reconstruction.pipeline.stages import composite_sources
from reconstruction.run.folder import RunFolder
from reconstruction.scene_model import SceneModel
from reconstruction.training.checkpoint import load_cloud


def scene_of(run: RunFolder, recording: Recording, cloud: SceneModel) -> Scene:
    """`cloud` with the cameras of `recording`, which are those the run ended with."""
    targets = lambda: composite_sources(run, recording)  # noqa: E731
    return Scene(cloud, recording.rig, run.white(), run.plan.model, run.config.holdout, targets)


def trained_scene(run: RunFolder) -> Scene:
    """What a run has learnt; raises BadRunError for one whose training has not ended."""
    if not run.has("train"):
        raise BadRunError("found no finished train stage", "a trained run", "finish it first", where=run.path)
    return scene_of(run, posed(run, Recording.open(run.recording), refined=True), load_cloud(run.checkpoint))
