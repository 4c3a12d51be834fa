"""Nothing before the report reads the held-out camera: with noise for its spikes a run is the same to the bit."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.recording.reader import Recording
from acquisition.session.record import simulate
from reconstruction.pipeline.artefacts import posed
from reconstruction.pipeline.report_page import SHOWN_INSTANTS
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import CHOICES, ReconstructionConfig
from reconstruction.training.checkpoint import load_checkpoint
from rigs.toml import catalog_rig

pytestmark = pytest.mark.slow
HOLDOUT = "cam11"
CONFIG = ReconstructionConfig(holdout=HOLDOUT, steps=4, budget_s=None, seed=1, gaussians=600)
NEEDS_A_CHECKPOINT = "dust3r"  # weights that the user supplies
WALL = {"seconds", "elapsed_s", "before_training_s", "recording"}  # what differs between any two runs


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "rec"
    simulation = Simulation("fan_and_ball", seed=3, rig_error=0.1, truth_every=64)
    simulate(simulation, catalog_rig("lab3x3").scaled(200, 125), 64, path)
    return path


@pytest.fixture(scope="module")
def noisy(recording):
    """The same recording with noise in place of what the held-out camera saw."""
    path = recording.parent / "noisy"
    shutil.copytree(recording, path)
    file = path / f"{HOLDOUT}.dat"
    noise = np.random.default_rng(0).integers(0, 256, file.stat().st_size, dtype=np.uint8)
    file.write_bytes(noise.tobytes())
    return path


def plain(value):
    """Nested values without wall times, tensors as bytes."""
    if isinstance(value, torch.Tensor):
        return value.detach().numpy().tobytes()
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items() if key not in WALL}
    return [plain(v) for v in value] if isinstance(value, list | tuple) else value


def left_by(path, out, init):
    """Everything a run leaves before its report."""
    run = reconstruct(path, out, replace(CONFIG, init=init), lambda stage: silent, last="train")
    arrays = {str(f.relative_to(out)): f.read_bytes() for f in out.rglob("*") if f.suffix in (".npy", ".toml")}
    states = {f.name: plain(load_checkpoint(f)) for f in (run.checkpoint, *run.snapshots())}
    return run, arrays, states, plain(run.document.to_json())


@pytest.mark.parametrize(
    "init",
    [
        pytest.param(name, marks=pytest.mark.long if name == "msdi" else ())
        for name in CHOICES["init"]
        if name not in ("auto", NEEDS_A_CHECKPOINT)
    ],
)
def test_noise_in_the_held_out_camera_changes_nothing(init, recording, noisy, tmp_path):
    run, *found = left_by(recording, tmp_path / "run", init)
    _, *same = left_by(noisy, tmp_path / "noisy", init)
    assert found == same
    assert run.document.held_out_used is False
    moved = posed(run, Recording.open(recording)).rig
    if init != "sweep":
        assert run.document.poses is not None
        assert run.document.poses["held_out_used"] is False
        given = Recording.open(recording).rig
        assert np.array_equal(moved.camera(HOLDOUT).center, given.camera(HOLDOUT).center)
        assert not np.allclose(moved.camera("cam00").center, given.camera("cam00").center, atol=1e-6)


def test_without_truth_it_is_placed_by_spikes_it_is_not_scored_on(recording, tmp_path):
    blind = tmp_path / "blind"
    shutil.copytree(recording, blind)
    shutil.rmtree(blind / "truth")
    config = replace(CONFIG, init="natural", steps=60, gaussians=6000)
    run = reconstruct(blind, tmp_path / "run", config, lambda stage: silent)
    assert "after training" in (run.path / "metrics.json").read_text()
    assert (run.path / "poses/held_out.toml").exists()
    page = (run.path / "report.html").read_text()
    assert page.count(f"<figcaption>what {HOLDOUT} saw, by its spikes, plane ") == SHOWN_INSTANTS
