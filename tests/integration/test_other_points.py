"""Whole runs that start from points that are not swept."""

from types import MappingProxyType

import numpy as np
import pytest

from acquisition.progress import silent
from acquisition.recording.reader import Recording
from reconstruction.initialization import initialisers
from reconstruction.initialization.geometry import Geometry
from reconstruction.initialization.points import Points
from reconstruction.pipeline import artefacts
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.truth import Truth
from rigs.camera import Camera

pytestmark = pytest.mark.slow
STEPS, GAUSSIANS = 4, 900


def seen_by(recording: Recording, camera: Camera, plane: int) -> np.ndarray:
    """Return the points [N, 3] that a camera truly sees at a plane with truth."""
    assert recording.truth is not None
    depth = Truth.open(recording.truth).frame(camera.id, plane).depth
    rows, columns = np.nonzero(np.isfinite(depth))
    rays = np.concatenate([camera.slopes(np.stack([columns + 0.5, rows + 0.5], axis=1)), np.ones((len(rows), 1))], 1)
    return camera.cam_from_rig.inverse().apply(rays * depth[rows, columns, None])


def finding(plane_of_points: int | None):
    """Return an initialiser that leaves the cameras alone and finds true points."""

    def find(recording, views, options, progress):
        points = seen_by(recording, recording.rig.camera(views[0]), 60)
        return Geometry(recording.rig, points, np.ones(len(points), np.float32), plane=plane_of_points)

    return find


@pytest.mark.parametrize(
    ("model", "points", "plane", "swept_movers"),
    [("4dgs-small", "random", None, False), ("4dgs-small", "found", 64, False), ("bases", "found", 64, True)],
)
def test_a_run_starts_from_other_points(small_recording, tmp_path, monkeypatch, model, points, plane, swept_movers):
    finds = {**initialisers.INITIALISERS, "msdi": finding(plane)}
    monkeypatch.setattr("reconstruction.pipeline.poses_stage.INITIALISERS", MappingProxyType(finds))
    swept = []
    monkeypatch.setattr(
        "reconstruction.pipeline.points_stage.moving_points", lambda *given: swept.append(given) or Points.none()
    )
    config = ReconstructionConfig(
        model, "msdi", points, holdout="cam11", steps=STEPS, budget_s=None, seed=1, gaussians=GAUSSIANS
    )
    run = reconstruct(small_recording, tmp_path / "run", config, lambda stage: silent, last="train")
    still, movers = (artefacts.read(run, name, Points) for name in (artefacts.STILL, artefacts.MOVERS))
    assert bool(swept) == swept_movers
    assert len(still) == run.plan.still_gaussians
    assert (len(movers) == run.plan.moving_gaussians) != swept_movers
    assert all(np.isnan(run.read_array(artefacts.DEPTH.format(view=view))).all() for view in run.plan.views)
    assert np.all(run.read_array(artefacts.GAINS) == 1)
    assert next(d for d in run.plan.decisions if d.about == "gains").override == "--points"
    assert run.document.steps == STEPS
