"""Tests that a crash leaves a valid prefix, and that finishing it twice changes nothing."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from acquisition.errors import BadRecordingError
from acquisition.recording.finalise import finalise, left_planes
from acquisition.recording.manifest import dump_manifest
from acquisition.recording.reader import Recording, read_manifest
from acquisition.recording.verify import verify
from acquisition.recording.writer import RecordingWriter
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

HERE = Path(__file__).parent
SMALL = PlaneLayout(9, 5)
PLANES = np.random.default_rng(0).integers(0, 256, (1000, SMALL.plane_bytes), dtype=np.uint8)
# The ring, the chunk being filled, the block being filled and the one in the camera's hands, in planes of 12,500 B.
MOST_LOST = ((4 << 20) + (1 << 20)) // 12_500 + 80 + 3 * 8


def record_and_kill(folder: Path, after_s: float) -> np.ndarray:
    """Kill a recorder `after_s` seconds after its first byte; returns how many planes of each camera it had taken."""
    taken = folder / "taken"
    taken.write_bytes(bytes(24))
    command = [sys.executable, str(HERE / "endless_recorder.py"), str(folder / "rec"), "2000", str(taken)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(HERE.parent)})
    while not np.fromfile(taken, dtype=np.uint64).all():
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.002)
    time.sleep(after_s)
    process.send_signal(signal.SIGKILL)
    _, err = process.communicate()
    assert err == b""
    return np.fromfile(taken, dtype=np.uint64)


def check_prefix(folder: Path, taken: np.ndarray) -> None:
    recording = Recording.open(folder / "rec")
    assert verify(folder / "rec") == []
    assert recording.manifest.status == "incomplete"
    for number, camera in enumerate(recording.manifest.cameras):
        kept = camera.planes - sum(gap.planes for gap in camera.gaps)
        assert taken[number] - kept <= MOST_LOST
        if not camera.planes:
            continue
        lost = np.zeros(camera.planes, dtype=bool)
        for gap in camera.gaps:
            lost[gap.first_plane : gap.first_plane + gap.planes] = True
        expected = np.where(lost, 0, 1 + (np.arange(camera.planes) * 7 + number * 31) % 255)
        packed = recording.stream(camera.id).packed
        np.testing.assert_array_equal(packed[:, 0], expected)
        np.testing.assert_array_equal(packed[:, -1], expected)
        in_camera = camera.drops["link"] / camera.planes
        assert in_camera == pytest.approx(1 / 50, abs=0.02 + 8 / camera.planes)


def killed_once(folder: Path, after_s: float) -> None:
    taken = record_and_kill(folder, after_s)
    try:
        finalise(folder / "rec")
    except BadRecordingError as error:
        assert "found no whole block" in str(error)  # noqa: PT017 (killed before the first chunk was full)
        assert taken.max() <= MOST_LOST
        return
    check_prefix(folder, taken)
    assert sorted(p.name for p in folder.iterdir()) == ["rec", "taken"]


@pytest.mark.parametrize("after_s", [0.0, 0.05, 0.21, 0.5])
def test_a_killed_recorder_leaves_a_valid_prefix(tmp_path, after_s):
    killed_once(tmp_path, after_s)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_killed_at_any_moment_it_leaves_a_valid_prefix(tmp_path, seed):
    killed_once(tmp_path, random.Random(seed).uniform(0, 2.0))


@pytest.fixture
def left(tmp_path):
    """Make the folder of a recorder killed between two blocks, without killing anything."""
    rig = Rig("pair", 20_000.0, tuple(Camera(i, 9, 5, 8.0, 8.0, 4.5, 2.5, Transform.identity()) for i in ("a", "b")))
    with RecordingWriter(tmp_path / "rec", rig) as recording:
        streams = [recording.stream(camera_id, SMALL) for camera_id in rig.ids]
        recording.mark("armed", "line")
        recording.mark("recording", "line")
        for stream in streams:
            stream.append(PLANES)
            stream.close()
        kept = tmp_path / "kept"
        recording.folder.rename(kept)
        recording.folder.mkdir()
    kept.rename(tmp_path / "rec.partial")
    return tmp_path / "rec.partial"


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_finishing_twice_changes_nothing(left, tmp_path):
    first = finalise(tmp_path / "rec")
    assert first.manifest.status == "incomplete"
    before = files(tmp_path / "rec")
    assert set(before) == {"recording.json", "rig.toml", "a.dat", "b.dat"}
    second = finalise(tmp_path / "rec")
    assert second == first
    assert files(tmp_path / "rec") == before
    assert (tmp_path / "rec/a.dat").read_bytes() == PLANES.tobytes()


def test_it_may_be_named_by_its_partial_folder(left, tmp_path):
    assert finalise(left).path == tmp_path / "rec"
    assert verify(tmp_path / "rec") == []


@pytest.mark.parametrize("tear", [b'{"block": 3, "pla', b"\0" * 40 + b"\n", b"[]\n", b'{"block": 9}\n', b"nonsense\n"])
def test_a_torn_journal_counts_up_to_the_tear(left, tmp_path, tear):
    lines = (left / "a.journal").read_bytes().splitlines(keepends=True)
    (left / "a.journal").write_bytes(b"".join(lines[:3]) + tear)
    manifest = finalise(left).manifest
    assert [camera.planes for camera in manifest.cameras] == [240, 1000]
    assert (tmp_path / "rec/a.dat").read_bytes() == PLANES[:240].tobytes()
    assert verify(tmp_path / "rec") == []


def test_a_block_that_is_not_on_the_disk_ends_the_prefix(left, tmp_path):
    data = bytearray((left / "b.dat").read_bytes())
    data[500 * SMALL.plane_bytes] ^= 1
    (left / "b.dat").write_bytes(data)
    (left / "a.dat").write_bytes(PLANES[:250].tobytes())
    manifest = finalise(left).manifest
    assert [camera.planes for camera in manifest.cameras] == [240, 480]
    assert verify(tmp_path / "rec") == []


def test_what_was_not_whole_goes(left, tmp_path):
    (left / "truth").mkdir()
    (left / "truth/half.npy").write_bytes(b"1")
    (left / ".recording.json.77.partial").write_bytes(b"{")
    finalise(left)
    assert set(files(tmp_path / "rec")) == {"recording.json", "rig.toml", "a.dat", "b.dat"}


def test_a_crash_before_the_name_is_given_loses_nothing(left, tmp_path):
    manifest = finalise(left).manifest
    (tmp_path / "rec").rename(left)
    assert finalise(tmp_path / "rec").manifest == manifest


def test_what_was_killed_between_its_manifest_and_its_name_is_counted_by_its_manifest(left, tmp_path):
    assert left_planes(tmp_path / "rec") == 1000
    finalise(left)
    (tmp_path / "rec").rename(left)  # without its journals, as `publish` leaves it for a moment
    assert left_planes(tmp_path / "rec") == 1000


def test_a_recording_without_sha256_is_sound_and_gets_them(left, tmp_path):
    manifest = finalise(left).manifest
    document = json.loads(dump_manifest(manifest))
    for camera in document["cameras"]:
        camera["sha256"] = None
    (tmp_path / "rec/recording.json").write_text(json.dumps(document))
    assert verify(tmp_path / "rec") == []
    assert finalise(tmp_path / "rec").manifest == manifest
    assert read_manifest(tmp_path / "rec") == manifest


def test_what_is_being_recorded_is_left_alone(tmp_path):
    rig = Rig("one", 20_000.0, (Camera("a", 9, 5, 8.0, 8.0, 4.5, 2.5, Transform.identity()),))
    with RecordingWriter(tmp_path / "rec", rig) as recording:
        recording.stream("a", SMALL)
        recording.mark("armed", "line")
        with pytest.raises(BadRecordingError, match="is being recorded now"):
            finalise(tmp_path / "rec")
        with pytest.raises(BadRecordingError, match=r"found it armed, .* run `spike4dgs finalise"):
            verify(tmp_path / "rec.partial")


def test_what_is_no_recording_is_refused(tmp_path):
    for path in (tmp_path, tmp_path / "nowhere", tmp_path / "x.partial"):
        with pytest.raises(BadRecordingError, match="expected"):
            finalise(path)
    (tmp_path / "x.partial").mkdir()
    with pytest.raises(BadRecordingError, match="expected"):
        finalise(tmp_path / "x")
    assert [path.name for path in tmp_path.iterdir()] == ["x.partial"]
