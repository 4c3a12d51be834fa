"""`python -m reconstruction.networks.train`, from clips to images by weights of one's own."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from reconstruction.networks import train
from reconstruction.networks.training.clips import CameraClip, CameraClips
from reconstruction.networks.training.image_validation import Scored

TINY = CameraClips(first_seed=1, count=1, size=24, planes=30, instants=(15,))


@pytest.fixture
def quick_scores(monkeypatch):
    clip = TINY.make(1)
    half = np.arange(24 * 24).reshape(24, 24) % 2 == 0
    known = CameraClip(clip.stream, clip.instants, clip.truth)
    monkeypatch.setattr(train, "validation_clips", lambda progress: [Scored(clip, 0.6), Scored(known, 0.6, half)])


def done(*arguments):
    result = CliRunner().invoke(train.main, list(map(str, arguments)), catch_exceptions=False)
    assert result.exit_code == 0, result.output


def test_clips_a_network_and_its_curve(tmp_path, quick_scores):
    done("clips", "--out", tmp_path / "clips", "--count", 2, "--size", 24)
    settings = ("--steps", 2, "--batch", 1, "--crop", 16, "--score-every", 1, "--threads", 1)
    done("network", "small", "--clips", tmp_path / "clips", "--out", tmp_path / "small", *settings)
    document = json.loads((tmp_path / "small" / "training.json").read_text())
    assert [set(point) for point in document["curve"]] == [
        {"step", "seconds", "loss", "random_db", "development_db", "moving_db"}
    ] * 2
    done("curve", tmp_path / "small" / "training.json", "--out", tmp_path / "curve.png")
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.long
def test_ones_own_recording_trains_the_blind_spot_network_that_then_makes_its_images(tmp_path, spike4dgs):
    recording, out = tmp_path / "rec", tmp_path / "own"
    simulate = ("simulate", "--scene", "fan_and_ball", "--ticks", 40, "--size", "40x26", "--out", recording)
    assert spike4dgs(*simulate)[0] == 0
    done("own", recording, "--out", out, "--steps", 2, "--crop", 16, "--score-every", 1)
    document = json.loads((out / "training.json").read_text())
    assert all(np.isfinite(point["unseen_loss"]) for point in document["curve"])
    images = ("images", recording, "--ticks", "20:21", "--out", tmp_path / "images")
    assert spike4dgs(*images, "--method", "blindspot", "--weights", out / "blindspot.npz")[0] == 0
    assert np.isfinite(np.load(tmp_path / "images" / "cam11" / "000020.npy")).all()
    status, _, errors = spike4dgs(*images, "--method", "tfi", "--weights", out / "blindspot.npz")
    assert status == 2
    assert "expected one of blindspot, msdi, spk2imgnet" in errors[-1]
    status, _, errors = spike4dgs(*images, "--method", "spk2imgnet", "--weights", out / "blindspot.npz")
    assert status == 2
    assert "other or damaged weights" in errors[-1]


def test_a_file_that_is_no_training_has_no_curve(tmp_path):
    (tmp_path / "training.json").write_text("{}")
    with pytest.raises(Exception, match="no curve of a training"):
        done("curve", tmp_path / "training.json", "--out", tmp_path / "curve.png")
