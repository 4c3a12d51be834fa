"""Movers that blur the images of a whole run: it renders as blurred, says so, and goes on alike where it is stopped."""

import pytest
import torch

from acquisition.progress import silent
from reconstruction.pipeline.budget import StoppedError
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.training.checkpoint import load_checkpoint, load_cloud

pytestmark = pytest.mark.slow
STEPS = 16
CONFIG = ReconstructionConfig(holdout="cam11", steps=STEPS, budget_s=None, seed=1, gaussians=2000)


def quiet(stage):
    return silent


def said(run):
    return next(d for d in run.plan.decisions if d.about == "exposure")


def test_fast_movers_are_rendered_as_blurred_as_their_images(small_recording, tmp_path, monkeypatch):
    monkeypatch.setattr("reconstruction.training.exposure.FAR_PX", 0.01)
    whole = reconstruct(small_recording, tmp_path / "whole", CONFIG, quiet)
    assert said(whole).choice == "2 instants an image from 50% on"
    assert load_checkpoint(whole.checkpoint)["trainer"]["passed_px"] > 0.01
    bodies = next(d.facts for d in whole.plan.decisions if d.about == "bodies")
    assert 1 <= bodies["bodies"] <= bodies["parts"]
    stops = iter([False] * (3 * STEPS // 4) + [True] * STEPS)
    with pytest.raises(StoppedError):
        reconstruct(small_recording, tmp_path / "stopped", CONFIG, quiet, should_stop=lambda: next(stops))
    resumed = reconstruct(small_recording, tmp_path / "stopped", CONFIG, quiet)
    assert resumed.plan == whole.plan
    for (name, a), (_, b) in zip(
        load_cloud(whole.checkpoint).tensors(), load_cloud(resumed.checkpoint).tensors(), strict=True
    ):
        assert torch.equal(a, b), name


def test_slow_ones_are_not_and_what_that_saves_is_said(small_recording, tmp_path, monkeypatch):
    monkeypatch.setattr("reconstruction.training.exposure.FAR_PX", 5.0)
    run = reconstruct(small_recording, tmp_path / "run", CONFIG, quiet)
    assert said(run).choice == "one instant an image"
    assert (said(run).saves_s or 0) > 0
