"""Cameras whose lenses bend, each its own way, from simulation to report and exports at 100x64."""

import json
from dataclasses import replace

import numpy as np
import pytest

from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.session.record import simulate
from reconstruction.export.catalogue import export_scene
from reconstruction.export.scene import Choices
from reconstruction.pipeline.stages import reconstruct
from reconstruction.pipeline.trained_scene import trained_scene
from reconstruction.run.configuration import ReconstructionConfig
from rigs.exchange.colmap import load_model
from rigs.exchange.nerfstudio import load_transforms
from rigs.toml import catalog_rig

pytestmark = pytest.mark.slow
CONFIG = ReconstructionConfig(holdout="cam11", steps=80, budget_s=None, seed=1, gaussians=3000)


@pytest.fixture(scope="module")
def rig():
    """Lenses, focal lengths and principal points differ; one is a fisheye, one does not bend."""
    plain = catalog_rig("ci3x3")
    cameras = [
        replace(c, distortion=(-0.17 + 0.01 * n, 0.01, 0.001, 0.0), fx=c.fx + n, cx=c.cx - 0.7 * n)
        for n, c in enumerate(plain.cameras)
    ]
    cameras[1] = replace(plain.cameras[1], lens_model="fisheye", distortion=(0.01, 0.0, 0.0, 0.0))
    cameras[8] = plain.cameras[8]
    return replace(plain, cameras=tuple(cameras))


@pytest.fixture(scope="module")
def run(rig, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lenses")
    simulate(Simulation("fan_and_ball", seed=3), rig, 120, folder / "rec")
    return reconstruct(folder / "rec", folder / "run", CONFIG, lambda stage: silent)


def test_it_beats_the_floors_in_the_original_camera(run):
    metrics = json.loads((run.path / "metrics.json").read_text())
    assert metrics["psnr_db"] > metrics["nearest_view.psnr_db"] + 5
    assert metrics["psnr_db"] > 26  # 26.6
    assert metrics["abs_rel"] < 0.1


def test_exports_are_in_the_original_cameras(run, rig, tmp_path):
    scene = trained_scene(run)
    export_scene(scene, "depth", tmp_path / "depth", Choices(frames=1, camera="cam01"))
    assert json.loads((tmp_path / "depth" / "manifest.json").read_text())["camera"] == "cam01"
    assert np.load(tmp_path / "depth" / "000000.npy").shape == (64, 100)
    exports = (("nerfstudio", "transforms.json", Choices(frames=1)), ("colmap", "sparse/0", Choices()))
    for name, cameras, choices in exports:
        export_scene(scene, name, tmp_path / name, choices)
        found = (
            load_model(tmp_path / name / cameras) if name == "colmap" else load_transforms(tmp_path / name / cameras)
        )
        for camera in found:
            assert camera.lens == rig.camera(camera.id).lens


def test_clean_images_are_learnt_from_where_lenses_bend(run, tmp_path):
    config = replace(CONFIG, images="clean", steps=4)
    given = reconstruct(run.recording, tmp_path / "run", config, lambda stage: silent)
    assert json.loads((given.path / "metrics.json").read_text())["psnr_db"] > 15
