import errno
import functools
import hashlib
from pathlib import Path

import numpy as np
import pytest
import xxhash

from acquisition.errors import BadRecordingError, DiskError
from acquisition.recording import writer as writer_module
from acquisition.recording.chunk_writer import StreamSpace
from acquisition.recording.direct import DirectFile
from acquisition.recording.finalise import finalise
from acquisition.recording.manifest import Gap
from acquisition.recording.reader import Recording
from acquisition.recording.verify import verify
from acquisition.recording.writer import DiskUse, RecordingWriter
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

LAYOUT = PlaneLayout(9, 5)
HARDWARE = DiskUse(replace_left_over=False)
PLANES = np.random.default_rng(0).integers(0, 256, (200, LAYOUT.plane_bytes), dtype=np.uint8)


def rig_of(*ids: str) -> Rig:
    return Rig("pair", 20_000.0, tuple(Camera(i, 9, 5, 8.0, 8.0, 4.5, 2.5, Transform.identity()) for i in ids))


def write(out: Path, planes: np.ndarray = PLANES, sizes: tuple[int, ...] = (200,)) -> None:
    with RecordingWriter(out, rig_of("cam00"), planes.nbytes) as recording:
        stream = recording.stream("cam00", LAYOUT)
        first = 0
        for size in sizes:
            stream.append(planes[first : first + size])
            first += size
        stream.close()
        recording.commit([stream.entry()], "line")


@pytest.mark.parametrize("sizes", [(200,), (1,) * 200, (79, 2, 0, 80, 39)])
def test_the_file_and_its_digests_do_not_depend_on_the_cuts(tmp_path, sizes):
    write(tmp_path / "rec", sizes=sizes)
    data = (tmp_path / "rec/cam00.dat").read_bytes()
    entry = Recording.open(tmp_path / "rec").manifest.camera("cam00")
    assert data == PLANES.tobytes()
    assert entry.sha256 == hashlib.sha256(data).hexdigest()
    blocks = [data[i : i + 80 * LAYOUT.plane_bytes] for i in range(0, len(data), 80 * LAYOUT.plane_bytes)]
    assert entry.block_digests == tuple(map(xxhash.xxh3_64_hexdigest, blocks))
    assert verify(tmp_path / "rec") == []


def test_lost_planes_are_zeros_and_listed(tmp_path):
    with RecordingWriter(tmp_path / "rec", rig_of("cam00"), 0) as recording:
        stream = recording.stream("cam00", LAYOUT)
        stream.append(PLANES[:3])
        stream.append_lost([Gap(3, 100, "device"), Gap(103, 1, "link")])
        stream.append(PLANES[104:])
        stream.close()
        recording.commit([stream.entry()], "line")
    recording = Recording.open(tmp_path / "rec")
    expected = PLANES.copy()
    expected[3:104] = 0
    np.testing.assert_array_equal(recording.stream("cam00").packed, expected)
    assert recording.manifest.cameras[0].drops == {"device": 100, "link": 1, "ring": 0, "disk": 0}
    assert verify(tmp_path / "rec") == []


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt])
def test_a_failure_leaves_nothing(tmp_path, failure):
    def fail():
        with RecordingWriter(tmp_path / "rec", rig_of("cam00"), 0) as recording:
            recording.stream("cam00", LAYOUT).append(PLANES)
            raise failure

    with pytest.raises(failure):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_a_taken_name_is_refused_and_kept(tmp_path):
    write(tmp_path / "rec")
    before = (tmp_path / "rec/recording.json").read_bytes()
    with pytest.raises(BadRecordingError, match="exists already"):
        write(tmp_path / "rec")
    assert (tmp_path / "rec/recording.json").read_bytes() == before
    (tmp_path / "file").write_text("kept")
    with pytest.raises(BadRecordingError, match="exists already"):
        write(tmp_path / "file")


def test_an_empty_folder_is_taken_over(tmp_path):
    (tmp_path / "rec").mkdir()
    write(tmp_path / "rec")
    assert verify(tmp_path / "rec") == []


def test_what_a_killed_writer_left_is_replaced(tmp_path):
    (tmp_path / "rec.partial/truth").mkdir(parents=True)
    (tmp_path / "rec.partial/cam00.dat").write_bytes(b"half")
    write(tmp_path / "rec")
    assert [p.name for p in tmp_path.iterdir()] == ["rec"]
    assert not (tmp_path / "rec/truth").exists()


def test_two_writers_of_one_name_do_not_meet(tmp_path):
    with RecordingWriter(tmp_path / "rec", rig_of("cam00"), 0) as first:
        with pytest.raises(BadRecordingError, match="recorded now"):
            write(tmp_path / "rec")
        assert first.folder.exists()
    assert list(tmp_path.iterdir()) == []


def test_a_disk_without_room_is_refused_with_both_numbers(tmp_path, monkeypatch):
    monkeypatch.setattr(writer_module, "free_bytes", lambda folder: 5_000_000)
    with pytest.raises(DiskError, match=r"found 5000000 bytes free, expected at least 6048576") as caught:
        RecordingWriter(tmp_path / "rec", rig_of("cam00"), 5_000_000).__enter__()
    assert caught.value.exit_code == 2
    assert list(tmp_path.iterdir()) == []


class FullDisk(DirectFile):
    def write(self, data, offset):
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_disk_that_fills_up_is_one_clear_error(tmp_path, monkeypatch):
    monkeypatch.setattr(writer_module, "StreamSpace", functools.partial(StreamSpace, open_file=FullDisk))
    with pytest.raises(DiskError, match=r"cam00\.dat: the disk is full or failing \(No space left"):
        write(tmp_path / "rec")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt, BadRecordingError])
def test_what_real_cameras_saw_outlives_a_failure(tmp_path, failure, caplog):
    def fail():
        with RecordingWriter(tmp_path / "rec", rig_of("cam00"), HARDWARE) as recording:
            stream = recording.stream("cam00", LAYOUT)
            recording.mark("recording", "line")
            stream.append(PLANES)
            stream.close()
            if failure is not BadRecordingError:
                raise failure
            (tmp_path / "rec").mkdir()  # somebody takes the name meanwhile
            (tmp_path / "rec/notes.txt").write_text("mine")
            recording.commit([stream.entry()], "line")

    with pytest.raises(failure):
        fail()
    assert "`spike4dgs finalise" in caplog.text
    assert (tmp_path / "rec.partial").is_dir()
    if failure is BadRecordingError:
        (tmp_path / "rec/notes.txt").unlink()
    finalise(tmp_path / "rec")
    recording = Recording.open(tmp_path / "rec")
    np.testing.assert_array_equal(recording.stream("cam00").packed, PLANES)
    assert verify(tmp_path / "rec") == []


def test_real_cameras_that_saw_nothing_leave_nothing(tmp_path):
    def fail():
        with RecordingWriter(tmp_path / "rec", rig_of("cam00"), HARDWARE) as recording:
            recording.stream("cam00", LAYOUT)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert list(tmp_path.iterdir()) == []


def refuse_to_keep(handle):
    raise OSError(errno.EIO, "Input/output error")


def test_a_file_that_the_disk_does_not_promise_to_keep_ends_no_other(tmp_path, monkeypatch):
    with RecordingWriter(tmp_path / "rec", rig_of("cam00", "cam01"), HARDWARE) as recording:
        streams = [recording.stream(camera_id, LAYOUT) for camera_id in ("cam00", "cam01")]
        for stream in streams:
            stream.append(PLANES)

        streams[0].close_keeping()
        with monkeypatch.context() as failing:  # as Linux tells it: once for each open file
            failing.setattr("os.fsync", refuse_to_keep)
            streams[1].close_keeping()
        manifest = recording.commit(recording.entries(), "line")
    assert manifest.status == "incomplete"
    assert "cam01.dat" in (manifest.reason or "")
    assert "Input/output error" in (manifest.reason or "")
    np.testing.assert_array_equal(Recording.open(tmp_path / "rec").stream("cam00").packed, PLANES)
