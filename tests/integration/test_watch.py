"""A plan that took a mover for still: the watch undoes it in a whole run, also when that run is killed around it."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from acquisition.progress import silent
from acquisition.recording.reader import Recording
from reconstruction.pipeline.budget import StoppedError
from reconstruction.pipeline.stages import reconstruct
from reconstruction.pipeline.train_stage import trainer_of
from reconstruction.pipeline.watch import Watch
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import load_checkpoint, load_cloud

pytestmark = pytest.mark.slow
STEPS, WATCHED = 24, 6
CONFIG = ReconstructionConfig(holdout="cam11", steps=STEPS, budget_s=None, seed=1, gaussians=2000)


def quiet(stage):
    return silent


@pytest.fixture(scope="module")
def blind(small_recording, tmp_path_factory):
    """A run up to its training whose plan took everything for still."""
    path = tmp_path_factory.mktemp("runs") / "blind"
    run = reconstruct(small_recording, path, CONFIG, quiet, stage="plan")
    for view in run.plan.views:
        run.write_array(f"plan/moving_{view}", np.zeros_like(run.read_array(f"plan/moving_{view}")))
    still = {"model": "static", "still_gaussians": CONFIG.gaussians, "moving_gaussians": 0}
    run.document.planned = replace(run.plan, **still)
    run.save()
    for stage in ("poses", "images", "points"):
        reconstruct(small_recording, path, CONFIG, quiet, stage=stage)
    return path


def trained(small_recording, blind, out, kills=()):
    """A copy of `blind` trained to the end, killed after each of `kills` steps on the way."""
    shutil.copytree(blind, out)
    for last in kills:
        steps = iter(range(10**6))
        done = load_checkpoint(out / "checkpoint.pt")["trainer"]["steps"] if (out / "checkpoint.pt").exists() else 0
        with pytest.raises(StoppedError, match=f"stopped at step {last}"):
            reconstruct(
                small_recording,
                out,
                CONFIG,
                quiet,
                stage="train",
                should_stop=lambda s=steps, n=last - done: next(s) == n - 1,
            )
    return reconstruct(small_recording, out, CONFIG, quiet, stage="train")


def beginning_trainer(run, path):
    recording = Recording.open(path)
    return trainer_of(run, recording)


@pytest.fixture(scope="module")
def whole(small_recording, blind, tmp_path_factory):
    return trained(small_recording, blind, tmp_path_factory.mktemp("runs") / "whole")


def test_what_moves_after_all_is_not_held_in_depth(small_recording, blind, whole, tmp_path):
    shutil.copytree(blind, tmp_path / "run")
    run = RunFolder.open(tmp_path / "run")
    trainer = beginning_trainer(run, small_recording)
    Watch(run, trainer).resume(load_checkpoint(whole.checkpoint)["watch"])
    anew = beginning_trainer(whole, small_recording)
    before = beginning_trainer(RunFolder.open(blind), small_recording)
    for now, later, then in zip(trainer.views, anew.views, before.views, strict=True):
        assert now.inverse_depth is not None
        assert later.inverse_depth is not None
        assert then.inverse_depth is not None
        assert not now.inverse_depth[now.source.moving].any()
        assert 0 < (now.inverse_depth > 0).sum() <= (then.inverse_depth > 0).sum()
        assert torch.equal(now.inverse_depth, later.inverse_depth)
    pairs = zip(anew.views, before.views, strict=True)
    assert any(t.inverse_depth[v.source.moving].any() for v, t in pairs if t.inverse_depth is not None)


def test_what_moves_is_found_and_the_plan_says_so(whole):
    plan = RunFolder.open(whole.path).plan
    assert plan.model == "linear"
    watch = next(d for d in plan.decisions if d.about == "watch")
    assert watch is not None
    assert watch.facts["pixels"] > 0
    assert "move after all" in watch.choice
    assert any(d.about == "motion" and d.choice == "linear" for d in plan.decisions)
    assert len(load_cloud(whole.checkpoint).moving) > 0
    assert any(whole.read_array(f"plan/moving_{view}").any() for view in plan.views)


@pytest.mark.parametrize("kills", [(WATCHED - 1,), (WATCHED,), (WATCHED - 1, WATCHED + 3)])
def test_killed_around_the_watch_it_ends_in_the_same_state(kills, whole, small_recording, blind, tmp_path):
    resumed = trained(small_recording, blind, tmp_path / "run", kills)
    for (name, a), (_, b) in zip(
        load_cloud(whole.checkpoint).tensors(), load_cloud(resumed.checkpoint).tensors(), strict=True
    ):
        assert torch.equal(a, b), name
    assert resumed.plan == whole.plan


def test_killed_between_checkpoint_and_masks_it_ends_in_the_same_state(
    whole, small_recording, blind, tmp_path, monkeypatch
):
    shutil.copytree(blind, tmp_path / "run")
    monkeypatch.setattr("reconstruction.pipeline.watch.Watch._write", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        reconstruct(small_recording, tmp_path / "run", CONFIG, quiet, stage="train")
    assert RunFolder.open(tmp_path / "run").plan.model == "static"
    monkeypatch.undo()
    resumed = reconstruct(small_recording, tmp_path / "run", CONFIG, quiet, stage="train")
    for (name, a), (_, b) in zip(
        load_cloud(whole.checkpoint).tensors(), load_cloud(resumed.checkpoint).tensors(), strict=True
    ):
        assert torch.equal(a, b), name
    assert resumed.plan == whole.plan


def test_an_override_is_obeyed(small_recording, blind, tmp_path):
    shutil.copytree(blind, tmp_path / "run")
    run = RunFolder.open(tmp_path / "run")
    config = replace(CONFIG, model="static")
    run.document.configuration = config
    run.save()
    run = reconstruct(small_recording, run.path, config, quiet, stage="train")
    assert run.plan.model == "static"
    assert len(load_cloud(run.checkpoint).moving) == 0
    assert any(d.about == "watch" and d.choice == "obeys --model static" for d in run.plan.decisions)
