"""A recording that is still written shows the planes that all of its cameras have on the disk, and no others."""

import time

import numpy as np
import pytest

from acquisition.errors import BadRecordingError
from acquisition.recording.growing import is_written, open_growing
from acquisition.recording.manifest import block_planes_of
from acquisition.recording.reader import Recording
from acquisition.recording.writer import RecordingWriter, partial_of
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

LAYOUT = PlaneLayout(160, 102)
BLOCK, CHUNK = block_planes_of(LAYOUT), 128  # planes of a digest, and of what is written at once
LESS, MORE = 300, 500  # planes of the two cameras
AT_HAND = LESS // CHUNK * CHUNK // BLOCK * BLOCK
RIG = Rig(
    "pair",
    20_000.0,
    tuple(Camera(i, 160, 102, 80.0, 80.0, 80.0, 51.0, Transform.identity()) for i in ("cam00", "cam01")),
)


def planes_of(seed, count):
    return np.random.default_rng(seed).integers(0, 256, (count, LAYOUT.plane_bytes), dtype=np.uint8)


def awaited(path, planes, of=lambda found: found.planes):
    """Return the recording when it has so many planes on the disk; the writer has a thread of its own."""
    until = time.monotonic() + 30
    while of(found := open_growing(path)) < planes and time.monotonic() < until:
        time.sleep(0.005)
    assert of(found) >= planes
    return found


@pytest.fixture
def writing(tmp_path):
    """The recording, its writer, and its two streams, armed."""
    with RecordingWriter(tmp_path / "rec", RIG, 0) as writer:
        streams = [writer.stream(camera.id, LAYOUT) for camera in RIG.cameras]
        writer.mark("recording", "line")
        yield tmp_path / "rec", writer, streams


def put(streams, *counts):
    for seed, (stream, count) in enumerate(zip(streams, counts, strict=True)):
        stream.append(planes_of(seed, 1000)[:count])


def commit(writer, streams):
    for stream in streams:
        stream.close()
    writer.commit([stream.entry() for stream in streams], "line")


def test_it_has_the_planes_that_every_camera_has_on_the_disk(writing):
    path, writer, streams = writing
    assert open_growing(path).planes == 0
    put(streams, MORE, LESS)
    found = awaited(path, AT_HAND)
    assert found.planes == AT_HAND == 240
    for seed, camera in enumerate(RIG.cameras):
        part = found.part(BLOCK, AT_HAND)
        np.testing.assert_array_equal(part.stream(camera.id).packed, planes_of(seed, 1000)[BLOCK:AT_HAND])
    assert is_written(path)
    commit(writer, streams)
    assert not is_written(path)
    assert open_growing(path).manifest == Recording.open(path).manifest


def test_a_disk_that_is_ahead_of_the_digests_hides_no_plane(writing, monkeypatch):
    path, _, streams = writing
    for stream in streams:

        def add_late(data, stream=stream, add=stream._digests.add):
            while stream.disk.written < LESS // CHUNK * CHUNK * LAYOUT.plane_bytes:
                time.sleep(0.001)
            time.sleep(0.05)  # what the disk's thread does then is look for what holds now
            add(data)

        monkeypatch.setattr(stream._digests, "add", add_late)
    put(streams, LESS, LESS)
    assert awaited(path, AT_HAND).planes == AT_HAND


def test_one_that_was_opened_before_it_got_its_name_is_read_on(writing):
    path, writer, streams = writing
    put(streams, LESS, LESS)
    found = awaited(path, AT_HAND)
    commit(writer, streams)
    assert not partial_of(path).exists()
    assert len(found.part(None, None).stream("cam01")) == AT_HAND
    np.testing.assert_array_equal(found.part(7, 11).stream("cam01").packed, planes_of(1, 1000)[7:11])
    assert Recording.open(path).planes == LESS


def test_a_camera_without_a_plane_leaves_none(writing):
    path, _, streams = writing
    put(streams, LESS, 0)
    found = awaited(path, 1, of=lambda found: found.manifest.camera("cam00").planes)
    assert found.planes == 0
    with pytest.raises(BadRecordingError, match="found no plane of cam01"):
        found.stream("cam01")


def test_a_finished_one_is_opened_as_ever_and_nothing_is_refused(writing, tmp_path):
    with pytest.raises(BadRecordingError, match="a recording folder"):
        open_growing(tmp_path / "nothing")
    assert not is_written(tmp_path / "nothing")
    path, writer, streams = writing
    put(streams, 5, 7)
    commit(writer, streams)
    assert open_growing(path).planes == 5
