"""Lenses that bend are calibrated with a board, by the commands a person types, and then reconstructed with."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from acquisition.durable import write_durably
from acquisition.scenes import calibration
from acquisition.scenes.bodies import at
from acquisition.scenes.motion import Movement
from rigs.exchange.nerfstudio import load_transforms
from rigs.toml import dump_rig, load_rig
from server.cli.main import main

pytestmark = pytest.mark.slow
SPEC = "charuco:6x4:100:67.5:DICT_4X4_50"
POSES, WINDOW = 18, 17  # poses of the board, and planes that it is held in each: those of one picture
LENSES = ("--lens", "10%", "--lens-spread", 0.1, "--rig-error", 1, "--seed", 3)
WAVED = replace(calibration.WAVED, start=at(0.0, 0.0, 1.0), reach_m=(0.22, 0.13, 0.25))  # near, for so few pixels


class Held(Movement):
    """The waved board, held still in POSES of the poses that it goes through in half a second."""

    def _poses(self, instants_s):
        steps = np.floor(instants_s * 20000 / WINDOW + 1e-9)
        return tuple(WAVED.world_from_body(0.5 * steps / POSES))


def run(command, *args):
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sys, "argv", ["spike4dgs", command, *map(str, args)])
        patched.setattr(calibration, "WAVED", Held())
        with pytest.raises(SystemExit) as caught:
            main()
    assert caught.value.code == 0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A board before the rig at 200x125, a rig file calibrated with it, and a scene before the same rig at 96x60."""
    pytest.importorskip("cv2", reason="boards are found with OpenCV", exc_type=ImportError)
    folder = tmp_path_factory.mktemp("lens")
    board = ("--size", "200x125", "--ticks", POSES * WINDOW, "--samples", 1, "--truth-every", 9999)
    run("simulate", "--scene", "board_charuco_moving", *LENSES, *board, "--out", folder / "board")
    run("calibrate", folder / "board", "--board", SPEC, "--out", folder / "lab.toml")
    scene = ("--rig", folder / "lab.toml", "--size", "96x60", "--ticks", 80)
    run("simulate", "--scene", "fan_and_ball", *LENSES, *scene, "--out", folder / "found")
    return folder


def seen_by(folder, name, cameras):
    """Return the recording with other cameras in its rig file."""
    out = folder / name
    out.mkdir()
    for file in (folder / "found").iterdir():
        if file.name != "rig.toml":
            (out / file.name).symlink_to(file)
    write_durably(out / "rig.toml", dump_rig(replace(load_rig(folder / "found/rig.toml"), cameras=tuple(cameras))))
    return out


def psnr_db(recording):
    out = recording.with_name(f"run-{recording.name}")
    run("reconstruct", recording, "--out", out, "--holdout", "cam11", "--steps", 60, "--seed", 1)
    return json.loads((out / "metrics.json").read_text())["psnr_db"]


def test_a_board_finds_the_lens_of_each_camera(folder):
    found = load_rig(folder / "lab.toml")
    true = {camera.id: camera for camera in load_transforms(folder / "board/truth/cameras.json")}
    bends = np.array([(camera.distortion[0], true[camera.id].distortion[0]) for camera in found.cameras])
    assert found.poses == "calibrated"
    assert np.ptp(bends[:, 1]) > 0.03  # lenses differ
    assert np.abs(bends[:, 0] - bends[:, 1]).max() < 0.006


def test_a_scene_is_reconstructed_by_the_lenses_found(folder):
    rig = load_rig(folder / "found/rig.toml")
    true = {camera.id: camera for camera in load_transforms(folder / "found/truth/cameras.json")}
    assert all(camera.bends for camera in rig.cameras)
    found = psnr_db(folder / "found")
    best = psnr_db(seen_by(folder, "true", [replace(true[c.id], serial=c.serial) for c in rig.cameras]))
    ignoring = psnr_db(seen_by(folder, "straight", [camera.pinhole() for camera in rig.cameras]))
    assert found > best - 0.5  # 28.25 and 28.24 dB
    assert found > ignoring + 5  # 19.07 dB
