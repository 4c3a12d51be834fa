"""`spike4dgs export` of a real run at 100x62: every format, and what comes back when it is wrong."""

import json
import subprocess
import sys

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


def export(*arguments):
    command = [sys.executable, "-m", "server.cli", "export", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def refused(result, *words):
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    last = result.stderr.strip().splitlines()[-1]
    for word in words:
        assert word in last
    return True


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
def test_every_format_of_a_run(name, run, tmp_path):
    few = ("--frames", 3) if "frames" in FORMATS[name].takes else ()
    result = export(run, "--format", name, "--out", tmp_path / "out", *few)
    assert result.returncode == 0, result.stderr
    assert str(tmp_path / "out") in result.stdout
    assert (tmp_path / "out").is_dir() == FORMATS[name].folder
    assert [f.name for f in tmp_path.iterdir()] == ["out"]


@pytest.mark.slow
def test_nerfstudio_has_what_the_training_cameras_saw(run, tmp_path):
    assert export(run, "--format", "nerfstudio", "--frames", 2, "--out", tmp_path / "out").returncode == 0
    frames = load_frames(tmp_path / "out" / "transforms.json")
    assert {f.camera.id for f in frames} == {f"cam{r}{c}" for r in range(3) for c in range(3)} - {"cam11"}
    assert len(frames) == 16
    for picture in (tmp_path / "out" / "images").iterdir():
        pixels = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE)
        assert np.percentile(pixels, 99) > 2 * np.percentile(pixels, 1)


@pytest.mark.slow
def test_the_run_folder_has_what_export_writes_for_the_viewer(run, tmp_path):
    assert export(run, "--format", "viewer", "--out", tmp_path / "out").returncode == 0
    for name in ("viewer.json", "viewer.bin"):
        assert (run / name).read_bytes() == (tmp_path / "out" / name).read_bytes()


@pytest.mark.slow
def test_a_choice_that_cannot_be_met_is_one_line(run, tmp_path):
    out = ("--out", tmp_path / "out")
    assert refused(export(run, "--format", "ply", "--at", 7, *out), "7 s", "0 to 0.003 s")
    assert refused(export(run, "--format", "depth", "--camera", "cam99", *out), "cam99", "cam00")
    assert refused(export(run, "--format", "ply", "--out", run), "found a folder")
    assert refused(export(run, "--format", "colmap", "--out", run, "--overwrite"), "no export made")
    assert json.loads((run / "run.json").read_text())["status"] == "finished"


@pytest.mark.slow
def test_export_refuses_what_it_cannot_use(tmp_path):
    out = ("--out", tmp_path / "out")
    assert refused(export(tmp_path, "--format", "ply", *out), "run.json")
    assert refused(export(tmp_path, "--format", "obj", *out), "'obj'", "nerfstudio")
    assert refused(export(tmp_path, "--format", "ply", "--frames", 3, *out), "--frames", "--at")
    assert refused(export(tmp_path, "--format", "depth", "--frames", 0, *out), "0 frames")
    (tmp_path / "out").write_text("x")
    assert refused(export(tmp_path, "--format", "ply", *out), "--overwrite")
    assert (tmp_path / "out").read_text() == "x"
