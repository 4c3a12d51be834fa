"""The commands that make and check recordings, as a person meets them."""

import itertools
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from acquisition.devices.mock import MockBackend
from acquisition.recording.reader import Recording
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from rigs.exchange.nerfstudio import dump_transforms
from rigs.toml import catalog_rig, dump_rig, load_rig

LAYERS = ("device", "link", "ring", "disk")
SMALL = ("--size", "40x25", "--ticks", "30", "--truth-every", "30")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    out = tmp_path_factory.mktemp("cli") / "rec"
    args = [sys.executable, "-c", "from server.cli.main import main; main()", "simulate", "--scene", "fan_and_ball"]
    subprocess.run([*args, *SMALL, "--out", str(out)], check=True, capture_output=True)
    return out


def test_simulate_says_what_it_made(spike4dgs, tmp_path):
    code, out, err = spike4dgs("simulate", "--scene", "fan_and_ball", *SMALL, "--json", "--out", tmp_path / "rec")
    assert code == 0
    assert json.loads(out)["cameras"]["cam11"] == {"planes": 30, "drops": dict.fromkeys(LAYERS, 0)}
    assert err[-1].startswith("simulate 100%")
    recording = Recording.open(tmp_path / "rec")
    assert recording.rig.cameras[0].width == 40
    assert recording.rig.cameras[0].fx == pytest.approx(catalog_rig("lab3x3").cameras[0].fx / 10)


def test_simulate_takes_another_rate_and_another_light(spike4dgs, tmp_path):
    rec, more = tmp_path / "rec", ("--rate", "2000", "--light", "0.1", "--sensor", "ideal")
    assert spike4dgs("simulate", "--scene", "static", *SMALL, *more, "--out", rec)[0] == 0
    recording, scene = Recording.open(rec), json.loads((rec / "truth/scene.json").read_text())
    assert recording.tick_rate_hz == scene["tick_rate_hz"] == 2000
    assert scene["white"] == pytest.approx(0.06)
    light = np.load(rec / "truth/cam11/000000.npy")
    assert recording.stream("cam11").counts(0, 30).mean() / 30 == pytest.approx(light.mean(), rel=0.1)
    code, _, err = spike4dgs("simulate", "--scene", "static", *SMALL, "--light", "0", "--out", tmp_path / "dark")
    assert code == 2
    assert "0" in err[-1]


def test_verify_accepts_and_finds_a_flipped_bit(spike4dgs, recorded, tmp_path):
    shutil.copytree(recorded, tmp_path / "rec")
    assert spike4dgs("verify", tmp_path / "rec")[0] == 0
    path = tmp_path / "rec/cam12.dat"
    data = bytearray(path.read_bytes())
    data[99] ^= 4
    path.write_bytes(data)
    code, out, _ = spike4dgs("verify", tmp_path / "rec")
    assert (code, out) == (1, "cam12.dat: block 0: planes 0 to 29 are not the recorded ones\n")
    code, out, _ = spike4dgs("verify", tmp_path / "rec", "--json")
    assert code == 1
    assert [d["file"] for d in json.loads(out)["damages"]] == ["cam12.dat"]


def test_verify_of_no_recording_is_bad_input(spike4dgs, tmp_path):
    code, out, err = spike4dgs("verify", tmp_path)
    assert (code, out) == (2, "")
    assert "expected a recording folder" in err[-1]


def test_record_takes_a_rig_file_and_a_device_uri(spike4dgs, recorded, tmp_path):
    (tmp_path / "small.toml").write_text(dump_rig(catalog_rig("lab3x3").scaled(40, 25)))
    uri = "mock:fan_and_ball?truth_every=30"
    args = ("--rig", tmp_path / "small.toml", "--ticks", 30, "--devices", uri, "--out", tmp_path / "rec")
    code, out, _ = spike4dgs("record", *args)
    assert code == 0
    assert "9 cameras, 30 planes each at 20000 Hz, 0 planes lost" in out
    for path in recorded.glob("*.dat"):
        assert (tmp_path / "rec" / path.name).read_bytes() == path.read_bytes()


@pytest.mark.parametrize("length", [(), ("--ticks", 3, "--until-stopped")])
def test_record_wants_one_length(spike4dgs, tmp_path, length):
    code, out, err = spike4dgs("record", "--rig", "lab3x3", *length, "--out", tmp_path / "rec")
    assert (code, out) == (2, "")
    assert "expected either --ticks N or --until-stopped" in err[-1]


@pytest.fixture
def recording(tmp_path, small_rig):
    """Starts `record` of a simulated rig in a process of its own."""
    running = []

    def start(*args, out="rec"):
        command = [sys.executable, "-m", "server.cli", "record", "--rig", str(small_rig), "--out", str(tmp_path / out)]
        uri = "mock:fan_and_ball?samples=1&truth_every=1000000"
        command += ["--devices", uri, *map(str, args)]
        running.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE))
        return running[-1]

    yield start
    for process in running:
        process.kill()
        process.communicate()


@pytest.fixture
def small_rig(tmp_path):
    (tmp_path / "small.toml").write_text(dump_rig(catalog_rig("lab3x3").scaled(40, 25)))
    return tmp_path / "small.toml"


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_run_until_stopped_ends_cleanly(spike4dgs, recording, tmp_path, how):
    process = recording("--until-stopped")
    wait_for_bytes(process, tmp_path / "rec.partial")
    process.send_signal(how)
    out, err = process.communicate()
    assert (process.returncode, b"Traceback" in err) == (0, False), err
    assert b"9 cameras" in out
    found = Recording.open(tmp_path / "rec")
    assert found.manifest.status == "complete"
    assert len({camera.planes for camera in found.manifest.cameras}) == 1
    assert spike4dgs("verify", tmp_path / "rec")[0] == 0


@pytest.mark.slow
def test_a_run_of_fixed_length_that_is_stopped_keeps_what_it_has(spike4dgs, recording, tmp_path):
    process = recording("--ticks", 100_000)
    wait_for_bytes(process, tmp_path / "rec.partial")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert (process.returncode, b"Traceback" in err) == (1, False), err
    manifest = Recording.open(tmp_path / "rec").manifest
    [planes] = {camera.planes for camera in manifest.cameras}
    assert 0 < planes < 100_000
    assert (manifest.status, manifest.reason) == ("incomplete", f"it was stopped after {planes} of 100000 planes")
    code, out, _ = spike4dgs("verify", tmp_path / "rec")
    assert (code, "sound, incomplete: it was stopped" in out) == (0, True)


def test_a_line_saves_from_before_it(recording, tmp_path):
    process = recording("--ticks", 300, "--pre-trigger", 5)
    while not (line := process.stderr.readline()).startswith(b"record   0% waiting to be told to save, 9 of 9"):
        assert line
    process.stdin.write(b"\n")
    process.stdin.flush()
    _, err = process.communicate()
    assert process.returncode == 0, err
    manifest = Recording.open(tmp_path / "rec").manifest
    assert {camera.planes for camera in manifest.cameras} == {300}
    assert 0 <= manifest.trigger_plane <= 100


@pytest.mark.slow
def test_a_second_operator_is_refused_by_the_rigs_name(spike4dgs, recording, tmp_path, small_rig):
    process = recording("--until-stopped")
    wait_for_bytes(process, tmp_path / "rec.partial")
    uri = "mock:fan_and_ball"
    args = ("--rig", small_rig, "--ticks", 3, "--devices", uri, "--out", tmp_path / "other")
    code, out, err = spike4dgs("record", *args)
    assert (code, out) == (2, "")
    assert "rig lab3x3: found it in use by" in err[-1]
    assert f"process {process.pid}, recording {tmp_path / 'rec'}" in err[-1]
    assert not (tmp_path / "other").exists()
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert spike4dgs("record", *args)[0] == 0


def test_a_camera_pulled_out_on_the_way_is_exit_1_and_its_line(spike4dgs, tmp_path, small_rig, monkeypatch):
    serial = catalog_rig("lab3x3").camera("cam12").serial

    class Pulled(MockBackend):
        """cam12's cable is pulled at its third transfer."""

        def open_stream(self, device):
            pipe = super().open_stream(device)
            if device.serial_number == serial:
                reap, reads = pipe.reap, itertools.count(1)
                pipe.reap = lambda timeout_s: (next(reads) == 3 and self.unplug(serial), reap(timeout_s))[1]
            return pipe

    monkeypatch.setattr("acquisition.devices.open.MockBackend", Pulled)
    uri = "mock:fan_and_ball?samples=1&truth_every=1000"
    args = ("--rig", small_rig, "--ticks", 400, "--devices", uri, "--out", tmp_path / "rec")
    code, _, err = spike4dgs("record", *args)
    assert code == 1
    assert f"cam12 (serial {serial}): it is not connected any more" in err[-1]
    assert err[-1].endswith("rec keeps what was recorded, marked incomplete")
    manifest = Recording.open(tmp_path / "rec").manifest
    assert [camera.id for camera in manifest.cameras if camera.written != 400] == ["cam12"]
    assert 0 < manifest.camera("cam12").written < 400
    code, out, _ = spike4dgs("verify", tmp_path / "rec")
    assert (code, "incomplete: cam12" in out) == (0, True)


def test_record_names_the_camera_that_is_missing(spike4dgs, tmp_path):
    first = catalog_rig("lab3x3").cameras[0]
    code, _, err = spike4dgs("record", "--rig", "lab3x3", "--ticks", 10, "--out", tmp_path / "rec")
    assert code == 2
    assert f"{first.id}: found no camera with serial {first.serial}" in err[-1]
    assert not (tmp_path / "rec").exists()


def test_import_takes_what_a_shell_pattern_gives(spike4dgs, recorded, tmp_path):
    files = sorted(recorded.glob("*.dat"))
    args = ("--cameras", recorded / "rig.toml", "--tick-rate", 20000, "--out", tmp_path / "rec")
    code, out, _ = spike4dgs("import", "--dat", *files, *args)
    assert code == 0
    assert "9 cameras, 30 planes" in out
    for path in files:
        assert (tmp_path / "rec" / path.name).read_bytes() == path.read_bytes()
    code, _, err = spike4dgs("import", *args[:-1], tmp_path / "other", "--poses", "nominal", "--dat", *files[:-1])
    assert code == 2
    assert "none for cam22" in err[-1]
    assert not (tmp_path / "other").exists()


def test_import_says_what_it_takes_the_poses_for(spike4dgs, recorded, tmp_path):
    rig = load_rig(recorded / "rig.toml")
    (tmp_path / "transforms.json").write_text(dump_transforms(rig.cameras))
    args = ("import", "--tick-rate", 20000, "--dat", *sorted(recorded.glob("*.dat")), "--cameras")
    doubt = "poses: those of transforms.json count as calibrated; give --poses nominal where it is a drawing"
    _, out, _ = spike4dgs(*args, tmp_path / "transforms.json", "--out", tmp_path / "doubtful")
    assert doubt in out
    for cameras, more in ((tmp_path / "transforms.json", ("--poses", "nominal")), (recorded / "rig.toml", ())):
        code, out, _ = spike4dgs(*args, cameras, "--out", tmp_path / f"sure-{len(more)}", *more)
        assert (code, doubt in out) == (0, False)


@pytest.mark.slow
def test_import_takes_its_size_from_spikecv_and_doubts_a_bit_order(spike4dgs, tmp_path):
    source = tmp_path / "source"
    made = spike4dgs(
        "simulate", "--scene", "fan_and_ball", "--size", "80x50", "--ticks", 40, "--spikecv", "--out", source
    )
    assert made[0] == 0
    args = ("import", "--dat", *sorted(source.glob("*.dat")), "--cameras", source / "rig.toml", "--tick-rate", 20000)
    config = ("--spikecv", source / "config.yaml")
    code, _, err = spike4dgs(*args, *config, "--out", tmp_path / "right")
    assert code == 0
    assert not [line for line in err if line.startswith("warning")]
    code, _, err = spike4dgs(*args, *config, "--bit-order", "msb", "--out", tmp_path / "wrong")
    assert code == 0
    doubts = [line for line in err if line.startswith("warning: cam")]
    assert len(doubts) == 9
    assert all(line.endswith("import it with --bit-order lsb") for line in doubts)
    code, _, err = spike4dgs(*args, *config, "--row-order", "top", "--out", tmp_path / "flipped")
    assert [line for line in err if line.startswith("warning")] == [err[0]]
    assert "with their rows reversed; import with the other --row-order" in err[0]
    code, _, err = spike4dgs(*args, *config, "--size", "40x25", "--out", tmp_path / "other")
    assert code == 2
    assert "found 80x50 pixels, expected the --size 40x25" in err[-1]


def flashed(folder, begins: int) -> Path:
    """Simulate a camera that began late, under a light switched on at plane 60."""
    light = np.where(np.arange(begins, begins + 120) < 60, 0.05, 0.5)
    scenery = np.random.default_rng(begins).uniform(0.2, 1, (25, 40))
    planes = Sensor(40, 25, "real", begins, 0).expose((light[:, None, None] * scenery).astype(np.float32))
    path = folder / f"{begins}.dat"
    path.write_bytes(pack(planes, PlaneLayout(40, 25)).tobytes())
    return path


def test_import_aligns_cameras_by_a_flash(spike4dgs, tmp_path):
    rig = catalog_rig("lab3x3").scaled(40, 25).only(["cam00", "cam01", "cam02"])
    (tmp_path / "rig.toml").write_text(dump_rig(rig))
    dats = [flashed(tmp_path, begins) for begins in (10, 3, 25)]
    args = ("import", "--cameras", tmp_path / "rig.toml", "--tick-rate", 20000, "--align", "--dat", *dats)
    code, _, err = spike4dgs(*args, "--out", tmp_path / "rec")
    assert code == 0
    assert [line for line in err if "cam02: began +15.0" in line]
    assert [line for line in err if line.startswith("cam01: began -") and line.endswith("first 22 planes are left out")]
    recording = Recording.open(tmp_path / "rec")
    entries = recording.manifest.cameras
    assert [entry.planes for entry in entries] == [105, 98, 120]
    for entry, dat, first in zip(entries, dats, (15, 22, 0), strict=True):  # the light comes on at plane 35 of each
        assert recording.stream(entry.id).packed.tobytes() == dat.read_bytes()[125 * first :]
        assert abs(entry.skew_s) <= 0.5 / 20_000
        assert entry.skew_sd_s < 0.5 / 20_000
    dats[1].write_bytes(bytes(125 * 120))
    code, _, err = spike4dgs(*args, "--out", tmp_path / "other")
    assert code == 2
    assert "cam01: found that its light never changes" in err[-1]
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("simulate", "--scene", "nowhere", "--out", "x"), "fan_and_ball"),
        (("simulate", "--scene", "fan_and_ball", "--size", "40", "--out", "x"), "WIDTHxHEIGHT"),
        (("simulate", "--scene", "fan_and_ball", "--size", "0x25", "--out", "x"), "WIDTHxHEIGHT"),
        (("simulate", "--scene", "fan_and_ball", "--ticks", "0", "--out", "x"), "ticks"),
        (("simulate", "--scene", "fan_and_ball", "--rig", "nowhere.toml", "--out", "x"), "nowhere.toml"),
        (("import", "--dat", "--cameras", "t.json", "--tick-rate", "1", "--out", "x"), "--dat"),
        (("import", "--dat", "a", "--cameras", "t.json", "--tick-rate", "1", "--out", "x"), "t.json"),
    ],
)
def test_bad_usage_is_one_line_and_exit_2(spike4dgs, tmp_path, monkeypatch, args, word):
    monkeypatch.chdir(tmp_path)
    code, out, err = spike4dgs(*args)
    assert (code, out) == (2, "")
    assert word in err[-1]
    assert list(tmp_path.iterdir()) == []


def wait_for_bytes(capture: subprocess.Popen, folder: Path) -> None:
    while not any(path.stat().st_size for path in folder.glob("*.dat")):
        assert capture.poll() is None
        time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_a_stopped_capture_has_no_name_and_can_be_made_again(tmp_path, how):
    out = tmp_path / "rec"
    command = [sys.executable, "-c", "from server.cli.main import main; main()", "simulate", "--scene", "fan_and_ball"]
    capture = subprocess.Popen(
        [*command, "--size", "100x64", "--ticks", "200000", "--out", str(out)], stderr=subprocess.PIPE
    )
    wait_for_bytes(capture, tmp_path / "rec.partial")
    capture.send_signal(how)
    _, err = capture.communicate()
    assert capture.returncode != 0
    assert b"Traceback" not in err
    assert not out.exists()
    assert (tmp_path / "rec.partial").exists() == (how == signal.SIGKILL)
    subprocess.run([*command, *SMALL, "--out", str(out)], check=True, capture_output=True)
    assert [path.name for path in tmp_path.iterdir()] == ["rec"]
