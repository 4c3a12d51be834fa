import json
import subprocess
import sys

import numpy as np
import pytest
import torch
from click.testing import CliRunner

from reconstruction.errors import BadRunError
from reconstruction.networks.msdi.depth import STEPS, Swept
from reconstruction.networks.msdi.features import keypoints
from reconstruction.networks.msdi.network import SHIPPED, small_msdi
from reconstruction.networks.msdi.views import Views, inverse_depths
from reconstruction.networks.train import main
from reconstruction.networks.training.clips import MultiviewClips, read_clip_set, write_clips
from reconstruction.networks.training.curve import plot_curves
from reconstruction.networks.training.msdi_losses import (
    IGNORED,
    UNSEEN,
    correspondences,
    depth_at,
    depth_loss,
    token_loss,
)
from reconstruction.networks.training.msdi_samples import Samples
from reconstruction.networks.training.msdi_training import MsdiConfig, MsdiTraining, sample_loss
from reconstruction.tensors import read_weights, write_weights

TINY = MultiviewClips(first_seed=5, count=2, views=3, width=56, height=40)


@pytest.fixture(autouse=True)
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # sums in one order
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clips")
    write_clips(folder, TINY)
    return folder


def training(out, folder, after=None, **settings):
    wanted = {"name": "small", "steps": 4, "score_every": 2, "image_from": 0, "pose_from": 0} | settings
    return MsdiTraining(out, MsdiConfig(**wanted), folder, "cpu", {}, after=after)


def sampled(maps, pixels):
    """Sample `maps` [V, C, H, W] at `pixels` [V, N, 2], bilinearly, to [V, N, C]; 0 outside."""
    grid = (2 * pixels.to(maps.dtype) / torch.tensor([maps.shape[3], maps.shape[2]]) - 1)[:, :, None]
    return torch.nn.functional.grid_sample(maps, grid, align_corners=False)[..., 0].transpose(1, 2)


def no_score(module):
    return {}


def test_clips_come_back_as_they_were_made(folder):
    assert read_clip_set(folder, MultiviewClips) == TINY
    made, found = TINY.make(6), TINY.read(folder, 6)
    for a, b in zip(made.streams, found.streams, strict=True):
        assert np.array_equal(a.packed, b.packed)
    assert np.allclose(made.light, found.light, rtol=1e-3)
    assert np.array_equal(made.depth, found.depth)
    assert made.white == found.white
    assert all(np.array_equal(a.K, b.K) for a, b in zip(made.rig.cameras, found.rig.cameras, strict=True))


def test_clips_that_are_lacking_other_or_impossible_are_refused(folder, tmp_path):
    with pytest.raises(BadRunError, match="give a new folder"):
        write_clips(folder, MultiviewClips(5, 3, 3, 56, 40))
    with pytest.raises(BadRunError, match=r"no readable clips\.json"):
        read_clip_set(tmp_path, MultiviewClips)
    (tmp_path / "clips.json").write_text(json.dumps({"schema": 1, "first_seed": 0}))
    with pytest.raises(BadRunError, match="expected clips of several views"):
        read_clip_set(tmp_path, MultiviewClips)
    with pytest.raises(BadRunError, match="2 to 9 views"):
        MultiviewClips(0, 1, 10)
    with pytest.raises(BadRunError, match="some of clutter, photographs, rooms"):
        MultiviewClips(0, 1, kinds=("clutter", "caves"))


def test_a_sample_is_the_same_whenever_it_is_asked_for(folder):
    torch.manual_seed(0)
    network = small_msdi()
    one, two = (Samples(folder, network, 3, 2.0, 10) for _ in range(2))
    one.sample(0, raw=False)
    a, b = one.sample(7, raw=False), two.sample(7, raw=False)
    assert torch.equal(a.maps, b.maps)
    assert torch.equal(a.nominal.rotation, b.nominal.rotation)
    raw = one.sample(7, raw=True)
    assert (a.raw, raw.raw) == (False, True)
    assert raw.maps.shape[2:] == a.maps.shape[2:]
    assert torch.equal(raw.light, a.light)


def test_true_correspondences_look_alike_however_the_sample_was_turned(folder):
    torch.manual_seed(0)
    samples = Samples(folder, small_msdi(), 0, 2.0, 10)
    alike = []
    for number in range(6):
        sample = samples.sample(number, raw=False)
        pixels = keypoints(sample.maps)
        seen, tokens = correspondences(sample.depth, sample.true, pixels)
        light = sample.light / sample.light.mean()
        here = sampled(light, pixels)[..., 0]
        for v in range(len(pixels)):
            for w in range(len(pixels)):
                kept = tokens[v, :, w] >= 0
                if v != w and kept.sum() > 5:
                    there = sampled(light[w : w + 1], seen[None, v, :, w])[0, :, 0]
                    alike.append(float(torch.corrcoef(torch.stack([here[v][kept], there[kept]]))[0, 1]))
                assert v != w or (tokens[v, :, w] == IGNORED).all()
    assert np.mean(alike) > 0.8


def test_depth_is_that_of_the_pixel_and_nothing_outside():
    depth = torch.arange(12.0).reshape(1, 3, 4)
    at = torch.tensor([[[1.5, 2.5], [3.99, 0.0], [-0.1, 1.0], [4.0, 1.0]]])
    found = depth_at(depth, at)[0]
    assert found[:2].tolist() == [9.0, 3.0]
    assert torch.isnan(found[2:]).all()


def test_the_token_loss_falls_with_the_share_of_the_true_token():
    tokens = torch.tensor([[[IGNORED, 1], [IGNORED, UNSEEN]], [[0, IGNORED], [0, IGNORED]]])
    allowed = torch.ones(2, 2, 2, 2, dtype=torch.bool)

    def loss(right):
        logits = torch.zeros(2, 2, 2, 3)
        logits[0, 0, 1, 1] = logits[0, 1, 1, 2] = logits[1, 0, 0, 0] = logits[1, 1, 0, 0] = right
        return float(token_loss(logits.log_softmax(-1), tokens, allowed))

    assert loss(0.0) == pytest.approx(np.log(3) * 6.5 / 7, rel=1e-5)  # a point that is unseen counts half
    assert loss(2.0) < loss(0.0) < loss(-2.0)


def test_the_depth_loss_is_least_at_the_truth():
    views = Views.of_rig(read_clip_set_rig())
    steps = inverse_depths(views, STEPS).float()
    depth = torch.full((16, 24), float(1 / steps[20]))

    def loss(at, confidence=2.0):
        logits = torch.full((STEPS, 4, 6), -5.0)
        logits[at] = 5.0
        inverse = torch.full_like(depth, float(steps[at]))
        return float(depth_loss(Swept(logits, inverse, torch.full_like(depth, confidence)), depth, views))

    assert loss(20) < loss(21) < loss(30)
    assert loss(20, confidence=10.0) < loss(20)
    assert loss(30, confidence=10.0) > loss(30)
    unknown = torch.full_like(depth, torch.nan)
    logits = torch.zeros(STEPS, 4, 6, requires_grad=True)
    depth_loss(Swept(logits, 1 / depth, 2 * torch.ones_like(depth)), unknown, views).backward()
    assert logits.grad is not None
    assert torch.isfinite(logits.grad).all()


def read_clip_set_rig():
    from acquisition.scenes.random.several_views import random_rig

    return random_rig(1, 3, 24, 16)


def test_apart_the_geometry_does_not_teach_the_images_and_joint_it_does(folder):
    torch.manual_seed(0)
    network = small_msdi()
    sample = Samples(folder, network, 0, 2.0, 10).sample(1, raw=True)
    grads = {}
    for joint in (False, True):
        network.zero_grad()
        sample_loss(network, sample, 0, joint=joint, pose=True, depth=True).backward()
        grads[joint] = [p.grad.clone() for p in network.image.parameters() if p.grad is not None]
    image_only = []
    network.zero_grad()
    from reconstruction.networks.image_networks import light_loss

    light, sigma, level = network.light(sample.maps)
    light_loss(light, sigma, sample.light, level).backward()
    image_only = [p.grad for p in network.image.parameters() if p.grad is not None]
    assert all(torch.allclose(a, b, atol=1e-6) for a, b in zip(grads[False], image_only, strict=True))
    assert any(not torch.allclose(a, b, atol=1e-4) for a, b in zip(grads[True], image_only, strict=True))


def test_an_image_network_from_scratch_learns_from_the_first_step(folder, tmp_path):
    known = training(tmp_path / "known", folder, steps=1, image_from=9, pose_from=9)
    fresh = training(tmp_path / "fresh", folder, steps=1, image_from=9, pose_from=9, pretrained=False)
    for run, learns in ((known, False), (fresh, True)):
        before = [p.clone() for p in run.module.image.parameters()]
        run.run(no_score)
        same = [torch.equal(a, b) for a, b in zip(before, run.module.image.parameters(), strict=True)]
        assert all(same) != learns
    pairs = zip(known.module.image.parameters(), fresh.module.image.parameters(), strict=True)
    assert not all(torch.allclose(a, b, atol=0.01) for a, b in pairs)


def test_a_killed_training_goes_on_as_if_it_had_not_been(folder, tmp_path):
    whole = training(tmp_path / "whole", folder)
    before = [p.clone() for p in whole.module.parameters()]
    whole.run(no_score)
    assert sum(not torch.equal(a, b) for a, b in zip(before, whole.module.parameters(), strict=True)) > 60
    stopped = training(tmp_path / "cut", folder)

    def die_after_three(fraction, message):
        if fraction > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped.run(no_score, die_after_three)
    resumed = training(tmp_path / "cut", folder)
    assert resumed.step == 2
    resumed.run(no_score)
    for a, b in zip(whole.average.parameters(), resumed.average.parameters(), strict=True):
        assert torch.equal(a, b)
    files = [(tmp_path / name / "small.npz").read_bytes() for name in ("whole", "cut")]
    assert files[0] == files[1]
    document = json.loads((tmp_path / "cut" / "training.json").read_text())
    assert document["pictures"]["clips"]["count"] == 2
    assert document["config"]["joint"] is True
    with pytest.raises(BadRunError, match="give a new folder"):
        training(tmp_path / "cut", folder, joint=False)


def test_a_training_begins_with_the_weights_of_an_earlier_one_and_tells_of_it(folder, tmp_path):
    training(tmp_path / "first", folder, steps=2).run(no_score)
    second = training(tmp_path / "second", folder, tmp_path / "first" / "training.json", steps=1, seed=1)
    learnt = small_msdi()
    read_weights(tmp_path / "first" / "small.npz", learnt)
    assert all(torch.equal(a, b) for a, b in zip(learnt.parameters(), second.module.parameters(), strict=True))
    second.run(no_score)
    third = training(tmp_path / "third", folder, tmp_path / "second" / "training.json", steps=1, seed=2)
    third.run(no_score)
    told = json.loads((tmp_path / "third" / "training.json").read_text())["after"]
    assert [(known["config"]["seed"], known["curve"][-1]["step"]) for known in told] == [(0, 2), (1, 1)]
    assert not any("after" in known for known in told)


@pytest.mark.parametrize("content", [None, "{", "[]"])
def test_a_document_that_tells_nothing_is_no_beginning(folder, tmp_path, content):
    training(tmp_path / "first", folder, steps=1).run(no_score)
    document = tmp_path / "first" / "training.json"
    document.unlink() if content is None else document.write_text(content)
    with pytest.raises(BadRunError, match="the document of a training, beside its weights"):
        training(tmp_path / "second", folder, document)


def test_the_curve_is_drawn_from_a_training_with_scores_only(tmp_path):
    point = {"step": 1, "seconds": 1.0, "loss": 1.0} | {f"random_{n}": 1.0 for n in ("deg", "abs_rel", "db")}
    document = {"config": {"joint": True}, "device": {"processor": "x", "threads": 1}, "curve": [point, point]}
    path = tmp_path / "training.json"
    path.write_text(json.dumps(document))
    plot_curves([path], tmp_path / "curve.png")
    alone = (tmp_path / "curve.png").stat().st_size
    assert alone > 5000
    path.write_text(json.dumps(document | {"after": [document]}))
    plot_curves([path], tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > alone + 1000  # the training before it is drawn, too
    for damaged in ({"curve": []}, {"after": [{}]}, {"after": [1]}):
        path.write_text(json.dumps(document | damaged))
        with pytest.raises(BadRunError, match="no curve of a training"):
            plot_curves([path], tmp_path / "curve.png")


def test_the_commands_say_what_they_take(tmp_path):
    shown = CliRunner().invoke(main, ["msdi", "--help"])
    assert "--joint / --separate" in shown.output
    wrong = CliRunner().invoke(main, ["msdi", "--clips", str(tmp_path), "--out", str(tmp_path / "run")])
    assert isinstance(wrong.exception, BadRunError)


@pytest.mark.slow
def test_weights_are_scored_on_random_clips_and_the_shipped_ones_are_ahead_of_none(tmp_path):
    torch.manual_seed(1)
    write_weights(tmp_path / "first.npz", small_msdi().state_dict())
    arguments = [str(SHIPPED / "small.npz"), str(tmp_path / "first.npz"), "--kind", "clutter", "--count", "1"]
    shown = CliRunner().invoke(main, ["msdi-scores", *arguments], catch_exceptions=False)
    shipped, first = (json.loads(line) for line in shown.stdout.splitlines())
    assert [found["scene"] for found in (shipped, first)] == ["clutter", "clutter"]
    assert [found["weights"] for found in (shipped, first)] == arguments[:2]
    assert 0 < shipped["deg"] < first["deg"]
    assert 0 < shipped["abs_rel"] < first["abs_rel"]


RANKED = """
import sys
from pathlib import Path

import torch

from reconstruction.networks.training import processes
from reconstruction.networks.training.msdi_training import MsdiConfig, MsdiTraining

torch.set_num_threads(1)
clips, out = map(Path, sys.argv[1:])
device = processes.start("cpu")
config = MsdiConfig("small", 2, score_every=2, image_from=0, pose_from=9)
training = MsdiTraining(out / "run", config, clips, device, {})
training.run(lambda module: {})
torch.save([p.detach() for p in training.module.parameters()], out / f"rank{torch.distributed.get_rank()}.pt")
processes.stop()
"""


@pytest.mark.slow
def test_two_processes_train_one_network(folder, tmp_path):
    """As torchrun starts them, with gloo: the same weights in both, of other samples than one process alone sees."""
    script = tmp_path / "ranked.py"
    script.write_text(RANKED)
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", str(script)]
    subprocess.run([*command, str(folder), str(tmp_path)], check=True, timeout=300, capture_output=True)
    one, two = (torch.load(tmp_path / f"rank{r}.pt", weights_only=True) for r in (0, 1))
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))
    alone = training(tmp_path / "alone", folder, steps=2, pose_from=9)
    alone.run(no_score)
    assert any(not torch.equal(a, b) for a, b in zip(one, alone.module.parameters(), strict=True))
    assert (tmp_path / "run" / "small.npz").exists()
