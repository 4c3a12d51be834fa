"""Recordings of 1 to 1,000,000 planes of 64x40: progress within files, the room they ask for, flat memory."""

import contextlib
import shutil
import tracemalloc
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from acquisition.errors import DiskError
from acquisition.recording import finalise as finalising
from acquisition.recording import writer as writing
from acquisition.recording.compaction import compact, restore
from acquisition.recording.finalise import finalise, left_planes
from acquisition.recording.importing import ImportOptions, import_recording
from acquisition.recording.manifest import MANIFEST_FILE, note_bytes
from acquisition.recording.reader import Recording
from acquisition.recording.verify import verify
from acquisition.recording.writer import MARGIN_BYTES, RecordingWriter, partial_of
from acquisition.session.alignment import firing_rate
from acquisition.session.record import Take, record
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.toml import dump_rig
from rigs.transform import Transform

LAYOUT = PlaneLayout(64, 40)
PERIOD = 1003  # planes after which the light is the same again: a prime beside blocks of 80 and of 400
FLAT_BYTES = 48 << 20  # memory of any step, whatever the length: rings, blocks at work, digests
LENGTHS = [
    *(1, 2, 63, 64, 65, 79, 80, 81, 399, 400, 401, 100_000),
    pytest.param(1_000_000, marks=[pytest.mark.slow, pytest.mark.long]),
]


def rig_of(cameras):
    ids = [f"cam0{number}" for number in range(cameras)]
    return Rig("row", 20_000.0, tuple(Camera(i, 64, 40, 60.0, 60.0, 32.0, 20.0, Transform.identity()) for i in ids))


def planes_from(first, last):
    """The planes [first, last): one row of pixels, which goes round."""
    planes = np.zeros((last - first, 40, 8), np.uint8)
    ticks = np.arange(first, last)
    planes[np.arange(len(ticks)), ticks % PERIOD % 40] = 0xFF
    return planes.reshape(len(ticks), -1)


def written(folder: Path, planes: int, cameras: int = 1) -> list[str]:
    """Write `.dat` files and their rig; return what to import."""
    folder.mkdir()
    (folder / "rig.toml").write_text(dump_rig(rig_of(cameras)))
    for camera_id in rig_of(cameras).ids:
        with (folder / f"{camera_id}.dat").open("wb") as file:
            for first in range(0, planes, 10_000):
                file.write(planes_from(first, min(planes, first + 10_000)).tobytes())
    return [f"{camera_id}={folder / camera_id}.dat" for camera_id in rig_of(cameras).ids]


@contextlib.contextmanager
def flat_memory():
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < FLAT_BYTES
    finally:
        tracemalloc.stop()


class Told:
    """A progress that is kept."""

    def __init__(self):
        self.fractions = []

    def __call__(self, fraction, message):
        self.fractions.append(fraction)

    def went_on(self, blocks):
        """Tell whether it went from 0 to 1 without a step back, nor one of more than a few blocks."""
        steps = [later - earlier for earlier, later in pairwise([0.0, *self.fractions])]
        return min(steps) >= 0 and self.fractions[-1] == 1 and max(steps) <= max(0.02, 2 / blocks)


@pytest.mark.parametrize("planes", LENGTHS)
def test_every_step_of_a_recording_goes_on_in_flat_memory(planes, tmp_path):
    dats, out, blocks = written(tmp_path / "dats", planes), tmp_path / "rec", -(-planes // 400)
    with flat_memory():
        told = Told()
        import_recording(dats, tmp_path / "dats" / "rig.toml", out, ImportOptions(20_000.0), told)
        assert told.went_on(blocks)
    assert Recording.open(out).planes == planes
    for change in (None, compact, restore):
        with flat_memory():
            if change:
                change(out, told := Told())
                assert told.fractions == sorted(told.fractions)
            told = Told()
            assert verify(out, told) == []
            assert told.went_on(blocks)
            stream = Recording.open(out).stream("cam00")
            for plane in {0, planes // 2, planes - 1}:
                np.testing.assert_array_equal(stream.window(plane, plane + 1), planes_from(plane, plane + 1))
    rate = firing_rate(Recording.open(out).stream("cam00"))
    np.testing.assert_allclose(rate, np.full(planes, 1 / 40))


def killed(folder: Path, planes: int, cameras: int = 1) -> Path:
    """Leave what a recorder that was killed leaves behind, and return the name that the recording would have had."""
    path = folder / "rec"
    with RecordingWriter(path, rig_of(cameras)) as recording:
        streams = [recording.stream(camera_id, LAYOUT) for camera_id in rig_of(cameras).ids]
        recording.mark("recording", "line")
        for stream in streams:
            for first in range(0, planes, 4000):
                stream.append(planes_from(first, min(planes, first + 4000)))
            stream.close()
        shutil.copytree(recording.folder, folder / "kept")
    (folder / "kept").rename(partial_of(path))
    return path


@pytest.mark.parametrize("planes", LENGTHS)
def test_what_a_killed_recorder_left_is_counted_and_finished(planes, tmp_path):
    path = killed(tmp_path, planes)
    assert left_planes(path) == planes
    with flat_memory():
        told = Told()
        finalise(path, told)
        assert told.went_on(-(-planes // 400))
    assert verify(path) == []
    assert Recording.open(path).planes == planes


def test_a_journal_is_read_again_only_where_it_has_grown(tmp_path, monkeypatch):
    path, read = killed(tmp_path, 1000, cameras=2), []
    known = finalising.read_journal
    monkeypatch.setattr(finalising, "read_journal", lambda *asked: read.append(asked) or known(*asked))
    assert [left_planes(path) for _ in range(5)] == [1000] * 5
    assert len(read) == 2
    with (partial_of(path) / "cam01.journal").open("a") as journal:
        journal.write('{"block": 13, "planes": 80, "xxh3": "0"}\n')
    assert left_planes(path) == 1000  # the block before it ends early, so nothing can follow
    assert len(read) == 3
    (partial_of(path) / "cam00.journal").unlink()
    assert left_planes(path) == 1000


@pytest.mark.parametrize("planes", [0, 1, 79, 80, 81, 100_000])
def test_a_journal_and_a_manifest_fit_the_room_that_was_asked_for_them(planes, tmp_path):
    path = killed(tmp_path, planes) if planes else None
    if path is None:
        assert note_bytes(0, LAYOUT) == 0
        return
    journal = (partial_of(path) / "cam00.journal").stat().st_size
    finalise(path)
    assert journal + (path / MANIFEST_FILE).stat().st_size <= note_bytes(planes, LAYOUT) + MARGIN_BYTES
    assert note_bytes(planes, LAYOUT) <= 2 * max(journal + (path / MANIFEST_FILE).stat().st_size, 128)


@pytest.mark.parametrize("planes", [1, 400, 1_000_000])
def test_a_recording_begins_only_where_its_notes_fit_too(planes, tmp_path, monkeypatch):
    rig = rig_of(2)
    needed = 2 * (planes * LAYOUT.plane_bytes + note_bytes(planes, LAYOUT)) + MARGIN_BYTES
    monkeypatch.setattr(writing, "free_bytes", lambda folder: needed - 1)
    with pytest.raises(DiskError, match=f"found {needed - 1} bytes free, expected at least {needed}"):
        record(rig, "usb:", Take(planes), tmp_path / "rec")
    assert not (tmp_path / "rec").exists()


def test_an_endless_recording_leaves_room_for_its_notes(tmp_path, monkeypatch):
    with RecordingWriter(tmp_path / "rec", rig_of(1)) as recording:
        stream = recording.stream("cam00", LAYOUT)
        stream.append(planes_from(0, 100_000))
        kept = MARGIN_BYTES + note_bytes(100_000, LAYOUT)
        monkeypatch.setattr(writing, "free_bytes", lambda folder: kept)
        assert recording._allows(0)  # the disk guard, as the stream's thread asks it
        monkeypatch.setattr(writing, "free_bytes", lambda folder: kept - 1)
        assert not recording._allows(0)
        assert recording.full == f"the disk had {kept - 1} bytes free, {MARGIN_BYTES} are kept free"
