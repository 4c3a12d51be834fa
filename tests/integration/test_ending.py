"""A training that gains nothing more ends before its budget and says so; one with `--steps` never does."""

import itertools
import json
from dataclasses import replace

import pytest

from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.recording.reader import Recording
from acquisition.session.record import simulate
from reconstruction.methods.catalogue import METHODS
from reconstruction.pipeline.budget import Budget
from reconstruction.pipeline.stages import reconstruct
from reconstruction.pipeline.train_stage import train_stage
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.training import ending
from reconstruction.training.checkpoint import load_checkpoint
from rigs.toml import catalog_rig

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "rec"
    simulate(Simulation("static", seed=3), catalog_rig("ci3x3"), 64, path)
    return path


def trained(recording, out, monkeypatch, **limits):
    """Trained under `limits` on a clock that ticks whenever it is read, in windows so short that every loss stands."""
    monkeypatch.setattr(ending, "WINDOW", 2)
    monkeypatch.setattr(ending, "LEAST_GAIN", 1.0)
    config = ReconstructionConfig(holdout="cam11", seed=1, gaussians=1000, **limits)
    for stage in ("plan", "poses", "images", "points"):
        run = reconstruct(recording, out, config, lambda _: silent, stage=stage)
    lines, ticks = [], itertools.count(0.0, 1.0)
    budget = Budget(lambda: next(ticks), 0.0, 0.0, config.budget_s, config.steps)
    train_stage(run, Recording.open(recording), lambda _, line: lines.append(line), budget, lambda: False)
    run.save()
    return run, lines


def test_it_ends_early_with_its_last_state_on_the_curve(recording, tmp_path, monkeypatch):
    run, lines = trained(recording, tmp_path / "run", monkeypatch, budget_s=400.0)
    document = json.loads((run.path / "run.json").read_text())
    steps = document["steps"]
    assert document["stopped_early"]["step"] == steps
    assert "rates ran down from step" in document["stopped_early"]["reason"]
    assert lines[-1].startswith(f"stopped early at step {steps}")
    assert load_checkpoint(run.checkpoint)["elapsed_s"] < 390
    assert load_checkpoint(run.snapshots()[-1])["steps"] == steps


def test_it_ends_after_the_steps_that_are_enough_for_its_method(recording, tmp_path, monkeypatch):
    for name, method in METHODS.items():
        monkeypatch.setitem(METHODS, name, replace(method, training=replace(method.training, enough_steps=9)))
    run, lines = trained(recording, tmp_path / "run", monkeypatch, budget_s=400.0)
    assert run.document.steps == 9
    assert run.document.stopped_early.reason.startswith("9 steps are enough")
    assert lines[-1].startswith("stopped early at step 9: ")
    assert load_checkpoint(run.snapshots()[-1])["steps"] == 9
    run, _ = trained(recording, tmp_path / "exact", monkeypatch, budget_s=None, steps=12)
    assert run.document.steps == 12


def test_steps_are_exact(recording, tmp_path, monkeypatch):
    run, _ = trained(recording, tmp_path / "run", monkeypatch, budget_s=None, steps=60)
    assert run.document.steps == 60
    assert run.document.stopped_early is None
