"""`spike4dgs export` of a real run at 100x62: every format, and what comes back when it is wrong."""

import json

import cv2
import numpy as np
import pytest

from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.session.record import simulate
from reconstruction.export.catalogue import FORMATS
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import ReconstructionConfig
from rigs.exchange.nerfstudio import load_frames
from rigs.toml import catalog_rig


@pytest.fixture
def export(spike4dgs):
    return lambda *arguments: spike4dgs("export", *arguments)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A short run with a held-out camera; slow to make, so only slow tests ask for it."""
    folder = tmp_path_factory.mktemp("export")
    rig = catalog_rig("ci3x3")
    simulate(Simulation("fan_and_ball", seed=2), rig, 60, folder / "rec")
    config = ReconstructionConfig(holdout="cam11", steps=20, budget_s=None, seed=1, gaussians=3000)
    return reconstruct(folder / "rec", folder / "run", config, lambda stage: silent).path


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_every_format_of_a_run(name, run, tmp_path, export):
    few = ("--frames", 3) if "frames" in FORMATS[name].takes else ()
    result = export(run, "--format", name, "--out", tmp_path / "out", *few)
    assert result.status == 0, result.lines
    assert str(tmp_path / "out") in result.out
    assert (tmp_path / "out").is_dir() == FORMATS[name].folder
    assert [f.name for f in tmp_path.iterdir()] == ["out"]


@pytest.mark.slow
def test_nerfstudio_has_what_the_training_cameras_saw(export, run, tmp_path):
    assert export(run, "--format", "nerfstudio", "--frames", 2, "--out", tmp_path / "out").status == 0
    frames = load_frames(tmp_path / "out" / "transforms.json")
    assert {f.camera.id for f in frames} == {f"cam{r}{c}" for r in range(3) for c in range(3)} - {"cam11"}
    assert len(frames) == 16
    for picture in (tmp_path / "out" / "images").iterdir():
        pixels = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE)
        assert np.percentile(pixels, 99) > 2 * np.percentile(pixels, 1)


@pytest.mark.slow
def test_the_run_folder_has_what_export_writes_for_the_viewer(export, run, tmp_path):
    assert export(run, "--format", "viewer", "--out", tmp_path / "out").status == 0
    for name in ("viewer.json", "viewer.bin"):
        assert (run / name).read_bytes() == (tmp_path / "out" / name).read_bytes()


@pytest.mark.slow
def test_a_choice_that_cannot_be_met_is_one_line(export, run, tmp_path):
    out = ("--out", tmp_path / "out")
    assert export(run, "--format", "ply", "--at", 7, *out).refused("7 s", "0 to 0.003 s")
    assert export(run, "--format", "depth", "--camera", "cam99", *out).refused("cam99", "cam00")
    assert export(run, "--format", "ply", "--out", run).refused("found a folder")
    assert export(run, "--format", "colmap", "--out", run, "--overwrite").refused("no export made")
    assert json.loads((run / "run.json").read_text())["status"] == "finished"


@pytest.mark.slow
def test_export_refuses_what_it_cannot_use(export, tmp_path):
    out = ("--out", tmp_path / "out")
    assert export(tmp_path, "--format", "ply", *out).refused("run.json")
    assert export(tmp_path, "--format", "obj", *out).refused("'obj'", "nerfstudio")
    assert export(tmp_path, "--format", "ply", "--frames", 3, *out).refused("--frames", "--at")
    assert export(tmp_path, "--format", "depth", "--frames", 0, *out).refused("0 frames")
    (tmp_path / "out").write_text("x")
    assert export(tmp_path, "--format", "ply", *out).refused("--overwrite")
    assert (tmp_path / "out").read_text() == "x"
