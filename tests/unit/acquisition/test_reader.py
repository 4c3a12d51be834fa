import numpy as np
import pytest

from acquisition.errors import BadRecordingError
from acquisition.recording.reader import Recording
from acquisition.recording.writer import RecordingWriter
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

LAYOUT = PlaneLayout(8, 3, row_order="top")


@pytest.fixture
def folder(tmp_path):
    cameras = tuple(Camera(i, 8, 3, 8.0, 8.0, 4.0, 1.5, Transform.identity()) for i in ("cam00", "cam01"))
    with RecordingWriter(tmp_path / "rec", Rig("pair", 40_000.0, cameras, "nominal"), 0) as recording:
        entries = []
        for planes, camera in zip((5, 7), cameras, strict=True):
            stream = recording.stream(camera.id, LAYOUT)
            stream.append(np.full((planes, 3), planes, dtype=np.uint8))
            stream.close()
            entries.append(stream.entry())
        recording.commit(entries, "software")
    return tmp_path / "rec"


def test_a_recording_tells_what_it_holds(folder):
    recording = Recording.open(folder)
    assert recording.camera_ids == ("cam00", "cam01")
    assert recording.tick_rate_hz == 40_000
    assert recording.planes == 5
    assert recording.rig.poses == "nominal"
    assert recording.manifest.camera("cam01").layout == LAYOUT
    assert recording.manifest.trigger == "software"
    assert recording.truth is None
    stream = recording.stream("cam01")
    assert len(stream) == 7
    assert stream.counts(0, 7).max() == 7


def test_truth_is_found(folder):
    (folder / "truth").mkdir()
    assert Recording.open(folder).truth == folder / "truth"


def test_what_is_no_recording_is_refused(tmp_path):
    with pytest.raises(BadRecordingError, match="expected a recording folder"):
        Recording.open(tmp_path)
    with pytest.raises(BadRecordingError, match="expected a recording folder"):
        Recording.open(tmp_path / "nowhere")


def test_a_stream_that_is_not_what_was_recorded_is_refused(folder):
    recording = Recording.open(folder)
    (folder / "cam01.dat").write_bytes(bytes(18))
    with pytest.raises(BadRecordingError, match="found 6 planes, expected 7"):
        recording.stream("cam01")
    with pytest.raises(BadRecordingError, match="cam99"):
        recording.stream("cam99")


def test_a_rig_with_a_camera_that_has_no_stream_is_refused(folder):
    rig = (folder / "rig.toml").read_text()
    (folder / "rig.toml").write_text(rig.replace('"cam01"', '"cam10"'))
    with pytest.raises(BadRecordingError, match="no stream of cam10"):
        Recording.open(folder)


def test_a_camera_that_never_sent_a_plane_is_one_clear_line(tmp_path):
    cameras = tuple(Camera(i, 8, 3, 8.0, 8.0, 4.0, 1.5, Transform.identity()) for i in ("cam00", "cam01"))
    with RecordingWriter(tmp_path / "rec", Rig("pair", 40_000.0, cameras), 0) as recording:
        streams = [recording.stream(camera.id, LAYOUT) for camera in cameras]
        streams[0].append(np.ones((5, 3), dtype=np.uint8))
        for stream in streams:
            stream.close()
        recording.problems.append("cam01: found no data")
        recording.commit(recording.entries(), "line")
    expected = "rec: found no plane of cam01, expected at least one; mend or leave it out, and record again$"
    with pytest.raises(BadRecordingError, match=expected):
        Recording.open(tmp_path / "rec").stream("cam01")


def test_a_part_is_as_long_as_the_cameras_in_use(folder):
    recording = Recording.open(folder)
    assert recording.part(None, None).planes == 5
    long = recording.part(None, None, ["cam01"])
    assert (long.planes, len(long.stream("cam01"))) == (7, 7)
    later = recording.part(4, 7, ["cam01"])
    assert (later.ticks, len(later.stream("cam01"))) == (range(4, 7), 3)
    with pytest.raises(BadRecordingError, match="expected ticks from 0 to 5"):
        recording.part(4, 7)
    assert later.part(5, 6).ticks == range(5, 6)


def test_a_camera_without_a_plane_is_named(tmp_path):
    cameras = tuple(Camera(i, 8, 3, 8.0, 8.0, 4.0, 1.5, Transform.identity()) for i in ("cam00", "cam01"))
    with RecordingWriter(tmp_path / "rec", Rig("pair", 40_000.0, cameras, "nominal"), 0) as recording:
        streams = [recording.stream(camera.id, LAYOUT) for camera in cameras]
        streams[0].append(np.full((5, 3), 5, dtype=np.uint8))
        for stream in streams:
            stream.close()
        recording.commit([stream.entry() for stream in streams], "software")
    recording = Recording.open(tmp_path / "rec")
    with pytest.raises(BadRecordingError, match="found no plane of cam01, expected at least one; leave it out"):
        recording.part(None, None)
    assert recording.part(None, None, ["cam00"]).planes == 5
