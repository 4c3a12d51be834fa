import json

import numpy as np
import pytest
import torch

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.networks.image_networks import image_network
from reconstruction.networks.training.clips import CameraClips, read_clip_set, write_clips
from reconstruction.networks.training.image_training import (
    Batches,
    ClipPictures,
    ImageTraining,
    ImageTrainingConfig,
    StreamPictures,
)

TINY = CameraClips(first_seed=7, count=3, size=24, planes=40, instants=(15, 25))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clips")
    write_clips(folder, TINY)
    return folder


@pytest.fixture(autouse=True)
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # sums in one order
    yield
    torch.set_num_threads(threads)


def config(**settings):
    return ImageTrainingConfig(**({"name": "small", "steps": 4, "batch": 2, "crop": 16, "score_every": 2} | settings))


def training(out, folder, **settings):
    wanted = config(**settings)
    return ImageTraining(out, wanted, ClipPictures(folder, image_network(wanted.name)))


def no_score(module):
    return {}


def test_clips_come_back_as_they_were_made_and_are_the_same_when_made_again(folder):
    assert read_clip_set(folder, CameraClips) == TINY
    made, found = TINY.make(8), TINY.read(folder, 8)
    assert np.array_equal(made.stream.packed, found.stream.packed)
    assert np.array_equal(made.truth, found.truth)
    assert found.truth.shape == (2, 24, 24)


def test_the_spikes_of_a_clip_are_those_of_its_truth(folder):
    for seed in TINY.seeds:
        clip = TINY.read(folder, seed)
        mean = clip.stream.counts(0, 40).mean() / 40
        assert mean == pytest.approx(clip.truth.mean(), rel=0.25, abs=0.01)


def test_a_killed_generator_makes_only_what_is_lacking(tmp_path):
    write_clips(tmp_path, TINY)
    kept, lost = sorted(tmp_path.glob("*.npz"))[:2]
    before, stamp = lost.read_bytes(), kept.stat().st_mtime_ns
    lost.unlink()
    with pytest.raises(BadRunError, match="1 clips missing of 3"):
        read_clip_set(tmp_path, CameraClips)
    write_clips(tmp_path, TINY)
    assert kept.stat().st_mtime_ns == stamp
    assert np.array_equal(np.load(lost)["packed"], TINY.read(tmp_path, 8).stream.packed)
    assert lost.read_bytes() == before


def test_a_folder_of_other_clips_or_none_is_refused(folder, tmp_path):
    with pytest.raises(BadRunError, match="give a new folder"):
        write_clips(folder, CameraClips(0, 3, 24))
    with pytest.raises(BadRunError, match=r"no readable clips\.json"):
        read_clip_set(tmp_path, CameraClips)


@pytest.mark.parametrize(
    "wrong", [{"count": 0}, {"first_seed": -1}, {"size": 4}, {"instants": (40,)}, {"instants": ()}]
)
def test_impossible_clip_sets_are_refused(wrong):
    with pytest.raises(BadRunError):
        CameraClips(**({"first_seed": 0, "count": 1, "planes": 40, "instants": (20,)} | wrong))


def test_batch_n_is_the_same_whenever_it_is_asked_for(folder):
    network = image_network("small")
    batches, others = (Batches(ClipPictures(folder, network), network, 3, 16, seed) for seed in (1, 1))
    for _ in range(3):
        batches.batch(0)
    for a, b in zip(batches.batch(5), others.batch(5), strict=True):
        assert torch.equal(a, b)
    assert not torch.equal(batches.batch(5)[0], batches.batch(6)[0])


def test_what_is_seen_and_the_truth_are_turned_alike(folder):
    """The mean rate over the longest window resembles the true light in every crop, however it was turned."""
    network = image_network("small")
    seen, truth = Batches(ClipPictures(folder, network), network, 16, 24, 0).batch(0)
    for rates, light in zip(seen, truth[:, 0], strict=True):
        if light.std() > 0.02:
            right = np.corrcoef(rates[7].ravel(), light.ravel())[0, 1]
            assert right > np.corrcoef(rates[7].ravel(), light.flip(1).ravel())[0, 1]


def test_crops_larger_than_the_pictures_are_refused(folder):
    with pytest.raises(BadRunError, match="crops up to 24 px"):
        training(None, folder, crop=25)


def test_a_killed_training_goes_on_as_if_it_had_not_been(folder, tmp_path):
    whole = training(tmp_path / "whole", folder)
    whole.run(no_score)
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
    assert [point["step"] for point in document["curve"]] == [2, 4]
    assert document["pictures"]["clips"]["first_seed"] == 7
    assert document["parameters"] == sum(p.numel() for p in whole.module.parameters())


def test_a_folder_of_another_training_is_refused(folder, tmp_path):
    training(tmp_path, folder, steps=2).run(no_score)
    assert training(tmp_path, folder, steps=6).step == 2
    with pytest.raises(BadRunError, match="give a new folder"):
        training(tmp_path, folder, seed=1)
    (tmp_path / "state.pt").write_bytes(b"junk")
    with pytest.raises(BadRunError, match="no readable checkpoint"):
        training(tmp_path, folder, steps=2)


def test_the_rate_rises_then_falls_to_a_fiftieth():
    wanted = config(steps=2000)
    rates = [wanted.rate(step) for step in range(2001)]
    assert rates[0] < 1e-5
    assert np.argmax(rates) == pytest.approx(199, abs=5)
    assert rates[-1] == pytest.approx(2e-5)


@pytest.mark.parametrize("wrong", [{"steps": 0}, {"learning_rate": 0}, {"averaged": 1}, {"score_every": 0}])
def test_impossible_trainings_are_refused(wrong):
    with pytest.raises(BadRunError, match="expected 1 step or more"):
        config(**wrong)


def test_the_blind_spot_network_trains_on_spikes_alone(tmp_path):
    planes = np.random.default_rng(0).integers(0, 2, (30, 20, 21)).astype(np.uint8)
    layout = PlaneLayout(21, 20)
    streams = [SpikeStream(pack(planes, layout), layout, 20000.0)] * 2
    network = image_network("blindspot")
    run = ImageTraining(tmp_path, config(name="blindspot"), StreamPictures(streams, network, 0))
    before = [p.clone() for p in run.module.parameters()]
    run.run(no_score)
    assert all(not torch.equal(a, b) for a, b in zip(before, run.module.parameters(), strict=True))
    assert len(json.loads((tmp_path / "training.json").read_text())["pictures"]["instants"]) == 64
    with pytest.raises(BadRunError, match="no true light"):
        ImageTraining(tmp_path / "other", config(), StreamPictures(streams, image_network("small"), 0)).run(no_score)


def test_a_recording_without_planes_is_refused():
    with pytest.raises(BadRunError, match="no planes to train on"):
        StreamPictures([], image_network("blindspot"), 0)
