"""A run whose training is done by torch and gsplat's signature, as on a GPU: with the reference in gsplat's place."""

import json

import pytest
import torch

from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.session.record import simulate
from reconstruction.gaussians import course, riding
from reconstruction.losses import picture
from reconstruction.pipeline.budget import StoppedError
from reconstruction.pipeline.stages import reconstruct
from reconstruction.rendering import gsplat_backend
from reconstruction.run.configuration import STAGES, ReconstructionConfig
from reconstruction.training import optimizer
from reconstruction.training.checkpoint import load_checkpoint, load_cloud
from rigs.toml import catalog_rig
from tests.unit.reconstruction.test_gsplat_backend import as_gsplat

pytestmark = pytest.mark.slow
CONFIG = ReconstructionConfig(holdout="cam11", steps=16, budget_s=None, seed=1, gaussians=600, device="cuda")


def quiet(stage):
    return silent


@pytest.fixture
def stand_in(monkeypatch):
    """Nothing of a training takes a kernel of ours."""
    monkeypatch.setattr(gsplat_backend, "why_unavailable", lambda: None)
    monkeypatch.setattr(gsplat_backend, "_rasterization", lambda: as_gsplat)
    monkeypatch.setattr(gsplat_backend, "DEVICE", "cpu")
    for module in (course, riding, picture, optimizer):
        monkeypatch.setattr(module, "fits", lambda *tensors: False)


def test_a_run_on_a_device_resumes_and_is_used_as_any_other(stand_in, tmp_path):
    recording = tmp_path / "rec"
    simulate(Simulation("fan_and_ball", seed=3), catalog_rig("ci3x3").scaled(64, 40), 64, recording)
    whole = reconstruct(recording, tmp_path / "whole", CONFIG, quiet)
    document = json.loads((whole.path / "run.json").read_text())
    assert (document["backend"], document["configuration"]["device"]) == ("gsplat", "cuda")
    metrics = json.loads((whole.path / "metrics.json").read_text())
    assert metrics["psnr_db"] > 10
    calls = iter(range(10**6))
    for stage in STAGES[:4]:
        reconstruct(recording, tmp_path / "run", CONFIG, quiet, stage=stage)
    with pytest.raises(StoppedError, match="stopped at step 7"):
        reconstruct(recording, tmp_path / "run", CONFIG, quiet, stage="train", should_stop=lambda: next(calls) == 6)
    assert load_checkpoint(tmp_path / "run" / "checkpoint.pt")["trainer"]["steps"] == 7
    resumed = reconstruct(recording, tmp_path / "run", CONFIG, quiet, stage="train")
    for (name, a), (_, b) in zip(*(load_cloud(r.checkpoint).tensors() for r in (whole, resumed)), strict=True):
        assert torch.equal(a, b), name
