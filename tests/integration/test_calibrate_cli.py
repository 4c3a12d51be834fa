"""From a flat and a dark recording to even pictures, by the commands a person types."""

import json
import shutil
import sys

import numpy as np
import pytest

from acquisition.recording.reader import Recording
from acquisition.recording.verify import verify
from reconstruction.images.pixels import read_pixels
from rigs.toml import dump_rig, load_rig
from server.cli.main import main

SIZE = ("--size", "60x40", "--truth-every", 1000)


@pytest.fixture(scope="module")
def spike4dgs():
    def run(*args):
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(sys, "argv", ["spike4dgs", *map(str, args)])
            with pytest.raises(SystemExit) as caught:
                main()
        return caught.value.code

    return run


@pytest.fixture(scope="module")
def lab(spike4dgs, tmp_path_factory):
    """A flat and a dark recording and one of a scene, all by the same sensors."""
    folder = tmp_path_factory.mktemp("lab")
    for scene, ticks in (("flat", 1000), ("dark", 1000), ("fan_and_ball", 80)):
        assert spike4dgs("simulate", "--scene", scene, *SIZE, "--ticks", ticks, "--out", folder / scene) == 0
    pixels = ("--pixels", folder / "flat", folder / "dark")
    assert spike4dgs("calibrate", folder / "fan_and_ball", *pixels, "--out", folder / "rigs/lab.toml") == 0
    return folder


def test_the_rig_has_a_calibration_for_each_camera(lab):
    rig = load_rig(lab / "rigs/lab.toml")
    gains = [read_pixels(camera.pixels).gain for camera in rig.cameras]
    assert {gain.shape for gain in gains} == {(40, 60)}
    assert all(gain.std() == pytest.approx(0.01, rel=0.1) for gain in gains)
    assert sorted(path.name for path in (lab / "rigs").iterdir())[0] == "lab-cam00-pixels.npz"


def test_a_recording_takes_the_calibration_with_it(spike4dgs, lab, tmp_path, capsys):
    pytest.importorskip("cv2", reason="images are made with OpenCV", exc_type=ImportError)
    rig = ("--rig", lab / "rigs/lab.toml", "--devices", "mock:flat?seed=0&truth_every=1000")
    assert spike4dgs("record", *rig, "--ticks", 600, "--out", tmp_path / "rec") == 0
    shutil.move(tmp_path / "rec", tmp_path / "moved")
    recording = Recording.open(tmp_path / "moved")
    assert recording.rig.cameras[0].pixels == tmp_path / "moved/lab-cam00-pixels.npz"
    assert verify(tmp_path / "moved") == []
    spoilt = tmp_path / "moved/lab-cam21-pixels.npz"
    data = spoilt.read_bytes()
    spoilt.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    assert [(found.file, found.reason) for found in verify(tmp_path / "moved")] == [
        ("lab-cam21-pixels.npz", "its SHA-256 is not the recorded one")
    ]
    spoilt.unlink()
    assert [str(found) for found in verify(tmp_path / "moved")] == [
        "lab-cam21-pixels.npz: cannot be read (No such file or directory)"
    ]
    spoilt.write_bytes(data)
    images = ("--method", "tfp", "--ticks", "300:301")
    assert spike4dgs("images", tmp_path / "moved", *images, "--out", tmp_path / "even") == 0
    for camera in recording.rig.cameras:
        (tmp_path / "moved/rig.toml").write_text(
            (tmp_path / "moved/rig.toml").read_text().replace(f'pixels = "lab-{camera.id}-pixels.npz"\n', "")
        )
    assert spike4dgs("images", tmp_path / "moved", *images, "--out", tmp_path / "raw") == 0
    even, raw = (np.load(tmp_path / f"{name}/cam11/000300.npy") for name in ("even", "raw"))
    stuck = read_pixels(lab / "rigs/lab-cam11-pixels.npz").defect
    assert even[~stuck].mean() == pytest.approx(raw[~stuck].mean(), rel=0.01)
    assert not np.array_equal(even, raw)


def test_what_was_found_is_printed(spike4dgs, lab, tmp_path, capsys):
    args = ("calibrate", lab / "fan_and_ball", "--pixels", lab / "flat", lab / "dark")
    assert spike4dgs(*args, "--out", tmp_path / "a.toml", "--json") == 0
    found = json.loads(capsys.readouterr().out)["cameras"]["cam22"]
    assert found.keys() == {"gain_spread", "mean_offset", "hot", "dead"}
    assert spike4dgs(*args, "--out", tmp_path / "b.toml") == 0
    assert "cam22: gain spread 1.00%" in capsys.readouterr().out


def test_recordings_that_do_not_serve_are_refused(spike4dgs, lab, tmp_path, capsys):
    def refusal(*args):
        assert spike4dgs("calibrate", *args) == 2
        return capsys.readouterr().err.strip().splitlines()[-1]

    scene, flat, dark = lab / "fan_and_ball", lab / "flat", lab / "dark"
    out = ("--out", tmp_path / "a.toml")
    assert "cam00: found 0 spikes a pixel of light" in refusal(scene, "--pixels", dark, flat, *out)
    assert "expected a recording folder" in refusal(scene, "--pixels", flat, tmp_path, *out)
    small = ("--size", "30x20", "--ticks", "500", "--truth-every", "500")
    assert spike4dgs("simulate", "--scene", "flat", *small, "--out", tmp_path / "small") == 0
    assert "a flat of 60x40 and a dark of 30x20" in refusal(scene, "--pixels", flat, tmp_path / "small", *out)
    assert "found 30x20 pixels, expected 60x40" in refusal(scene, "--pixels", tmp_path / "small", dark, *out)
    shutil.copytree(dark, tmp_path / "dark")
    manifest = json.loads((tmp_path / "dark/recording.json").read_text())
    manifest["cameras"] = manifest["cameras"][:6]
    (tmp_path / "dark/recording.json").write_text(json.dumps(manifest))
    rig = Recording.open(dark).rig
    (tmp_path / "dark/rig.toml").write_text(dump_rig(rig.only(rig.ids[:6])))
    assert "dark: found no camera cam20" in refusal(scene, "--pixels", flat, tmp_path / "dark", *out)
    assert not (tmp_path / "a.toml").exists()
    assert "exists already" in refusal(scene, "--pixels", flat, dark, "--out", lab / "rigs/lab.toml")


def test_a_scene_that_shows_too_little_is_refused_in_one_line(spike4dgs, lab, tmp_path, capsys):
    pytest.importorskip("cv2", reason="features are OpenCV's", exc_type=ImportError)
    assert spike4dgs("calibrate", lab / "fan_and_ball", "--natural", "--out", tmp_path / "rig.toml") == 1
    assert "tracks over 3 or more views, expected 250" in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "rig.toml").exists()
    assert spike4dgs("check-rig", lab / "fan_and_ball") == 1
    assert spike4dgs("check-rig", lab / "dark") == 1
    assert "found no light in cam00" in capsys.readouterr().err.splitlines()[-1]


def test_one_way_of_calibrating_is_asked_for(spike4dgs, lab, tmp_path, capsys):
    assert spike4dgs("calibrate", lab / "flat", "--out", tmp_path / "rig.toml") == 2
    both = ("--natural", "--board", "charuco:6x4:100:67.5:DICT_4X4_50")
    assert spike4dgs("calibrate", lab / "flat", *both, "--out", tmp_path / "rig.toml") == 2
    assert "one of --pixels, --board and --natural" in capsys.readouterr().err


def test_a_recording_is_not_told_what_its_manifest_says(spike4dgs, lab, capsys):
    rec = lab / "fan_and_ball"
    words = ("images", rec, "--method", "tfp", "--out", lab / "never", "--size", "7x7", "--tick-rate", "3")
    assert spike4dgs(*words) == 2
    assert "found --size and --tick-rate for a recording, expected none" in capsys.readouterr().err
    assert not (lab / "never").exists()
