"""A part of a recording has its planes and no others, on the clock of the whole, raw or compact."""

import dataclasses

import numpy as np
import pytest

from acquisition.durable import write_durably
from acquisition.errors import BadRecordingError
from acquisition.recording.compaction import compact
from acquisition.recording.manifest import MANIFEST_FILE, dump_manifest
from acquisition.recording.reader import Recording
from acquisition.recording.writer import RecordingWriter
from acquisition.spikes import compact as compact_planes
from acquisition.spikes.intervals import intervals
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.clock import RigClock
from rigs.rig import Rig
from rigs.transform import Transform

LAYOUT, PLANES, RATE_HZ = PlaneLayout(16, 8), 900, 20_000.0


def planes_of(seed):
    return np.random.default_rng(seed).integers(0, 256, (PLANES, LAYOUT.plane_bytes), dtype=np.uint8)


@pytest.fixture(params=["raw", "compact"])
def folder(request, tmp_path):
    cameras = tuple(Camera(i, 16, 8, 8.0, 8.0, 8.0, 4.0, Transform.identity()) for i in ("cam00", "cam01"))
    with RecordingWriter(tmp_path / "rec", Rig("pair", RATE_HZ, cameras), 0) as recording:
        streams = [recording.stream(camera.id, LAYOUT) for camera in cameras]
        for seed, stream in enumerate(streams):
            stream.append(planes_of(seed))
            stream.close()
        recording.commit([stream.entry() for stream in streams], "line")
    if request.param == "compact":
        compact(tmp_path / "rec")
    return tmp_path / "rec"


@pytest.mark.parametrize(("first", "last"), [(0, 1), (0, PLANES), (399, 401), (400, 800), (7, 893), (899, 900)])
def test_a_part_has_its_planes_and_their_instants(folder, first, last):
    whole = Recording.open(folder)
    part = whole.part(first, last)
    assert (part.planes, part.ticks) == (last - first, range(first, last))
    for seed, camera_id in enumerate(part.camera_ids):
        stream, planes = part.stream(camera_id), planes_of(seed)[first:last]
        assert len(stream) == last - first
        np.testing.assert_array_equal(stream.window(0, len(stream)), planes)
        np.testing.assert_array_equal(stream.packed[-1], planes[-1])
        counts = whole.stream(camera_id).counts(first, last)
        np.testing.assert_array_equal(stream.counts(0, len(stream)), counts)
        found = intervals(stream.packed, LAYOUT, [0, len(planes) - 1], 100)
        for a, b in zip(found, intervals(planes, LAYOUT, [0, len(planes) - 1], 100), strict=True):
            np.testing.assert_array_equal(a, b)
    for plane in (0, last - first - 1):
        assert part.rig.clock.instant_s(plane) == whole.rig.clock.instant_s(first + plane)
        assert part.rig.clock.plane(part.rig.clock.instant_s(plane)) == plane


def test_an_open_end_is_the_recording_s(folder):
    whole = Recording.open(folder)
    assert whole.part(None, None) is whole
    assert whole.part(300, None).ticks == range(300, PLANES)
    assert whole.part(None, 300).ticks == range(300)
    assert whole.part(100, 500).part(200, 300).stream("cam01").window(0, 1).tolist() == planes_of(1)[200:201].tolist()


@pytest.mark.parametrize(
    ("first", "last"), [(5, 5), (6, 5), (-1, 5), (0, PLANES + 1), (PLANES, None), (None, 0), (10**9, 2 * 10**9)]
)
def test_ticks_that_are_not_there_are_refused_in_one_line(folder, first, last):
    with pytest.raises(BadRecordingError, match="--from-tick") as refused:
        Recording.open(folder).part(first, last)
    assert "ticks from 0 to 900" in refused.value.expected
    assert "\n" not in str(refused.value)
    with pytest.raises(BadRecordingError, match="ticks from 100 to 200"):
        Recording.open(folder).part(100, 200).part(99, 200)


def test_a_recording_begins_at_its_first_tick(folder):
    whole = Recording.open(folder)
    cameras = tuple(dataclasses.replace(camera, first_tick=-40) for camera in whole.manifest.cameras)
    write_durably(folder / MANIFEST_FILE, dump_manifest(dataclasses.replace(whole.manifest, cameras=cameras)))
    late = Recording.open(folder)
    assert late.ticks == range(-40, PLANES - 40)
    assert late.rig.clock.instant_s(0) == RigClock(RATE_HZ).instant_s(-40)
    part = late.part(-30, 0)
    np.testing.assert_array_equal(part.stream("cam00").window(0, 30), planes_of(0)[10:40])
    with pytest.raises(BadRecordingError, match="ticks from -40 to 860"):
        late.part(-41, 0)


def test_of_a_compact_part_only_the_blocks_that_are_read_are_decoded(folder, monkeypatch):
    decoded, decode = [], compact_planes.decode
    monkeypatch.setattr(compact_planes, "decode", lambda block, *shape: decoded.append(shape) or decode(block, *shape))
    stream = Recording.open(folder).part(350, 900).stream("cam00")
    assert not decoded
    stream.window(0, 60)  # planes 350 to 409
    assert len(decoded) in (0, 2)  # none where it is raw
    stream.window(460, 500)  # planes 810 to 849
    assert len(decoded) in (0, 3)


def test_a_clock_of_a_part_turns_instants_into_its_planes():
    clock = RigClock(RATE_HZ, 10**6)
    for plane in (0, 1, 63, 64, 10**6 - 1):
        assert clock.plane(clock.instant_s(plane)) == plane
        assert clock.plane(clock.begins_s(plane)) == plane
    assert RigClock(RATE_HZ).begins_s(0) == 0.0
