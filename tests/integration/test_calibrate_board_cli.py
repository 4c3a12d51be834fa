"""From a recording of a calibration board to a rig file and a picture, by the command a person types."""

import json
import sys

import pytest

from rigs.toml import load_rig
from server.cli.main import main

SPEC = "charuco:6x4:100:67.5:DICT_4X4_50"


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
def still(spike4dgs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("boards") / "still"
    options = ("--ticks", 60, "--samples", 1, "--truth-every", 1000, "--rig-error", 1)
    assert spike4dgs("simulate", "--scene", "board_charuco", *options, "--out", folder) == 0
    return folder


@pytest.mark.slow
@pytest.mark.long
def test_a_board_gives_a_rig_file_and_a_picture(spike4dgs, still, tmp_path, capsys):
    pytest.importorskip("cv2", reason="boards are found with OpenCV", exc_type=ImportError)
    out = tmp_path / "rigs/lab.toml"
    assert spike4dgs("calibrate", still, "--board", SPEC, "--out", out, "--json") == 0
    said = capsys.readouterr()
    report = json.loads(said.out)
    assert report["poses"] == 1
    assert report["corners"]["cam11"] == 15
    assert "calibrate 100%" in said.err
    rig = load_rig(out)
    assert rig.poses == "calibrated"
    assert rig.calibration.residual_px == pytest.approx(report["residual_px"])
    assert (tmp_path / "rigs/lab-residuals.png").read_bytes().startswith(b"\x89PNG")
    assert spike4dgs("calibrate", still, "--board", SPEC, "--out", tmp_path / "b.toml") == 0
    assert "metric scale: from the board" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.long
def test_what_cannot_be_used_is_refused_in_a_line(spike4dgs, still, tmp_path, capsys):
    def refusal(*args, code=2):
        assert spike4dgs("calibrate", still, *args, "--out", tmp_path / "a.toml") == code
        assert not (tmp_path / "a.toml").exists()
        return capsys.readouterr().err.strip().splitlines()[-1]

    assert "give one of --pixels, --board and --natural" in refusal()
    assert "give one of --pixels, --board and --natural" in refusal("--board", SPEC, "--pixels", still, still)
    assert "found the board 'nonsense', expected charuco:COLS" in refusal("--board", "nonsense")
    assert "found tags of DICT_4X4_50, expected" in refusal("--board", "apriltag:4x3:96:28.8:36h11")
