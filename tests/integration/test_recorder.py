"""Tests that every plane is written or counted when the disk is slow, fills up or refuses."""

import errno
import functools
import resource
import threading
import time

import numpy as np
import pytest
from maintenance.plain_camera import PlainCamera

from acquisition.devices.protocol import Block
from acquisition.errors import StoppedError
from acquisition.recording import writer as writer_module
from acquisition.recording.chunk_writer import StreamSpace
from acquisition.recording.direct import DirectFile
from acquisition.recording.manifest import Manifest
from acquisition.recording.reader import Recording, read_any_manifest
from acquisition.recording.verify import verify
from acquisition.recording.writer import DiskUse, RecordingWriter
from acquisition.session.session import Control, record_session
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

LAYOUT = PlaneLayout(400, 250)
BLOCK_PLANES = 8
RATE_HZ = 20_000.0
IDS = ("cam00", "cam01", "cam02")


def plane_bytes(camera: int, plane: int) -> np.ndarray:
    return np.full(LAYOUT.plane_bytes, 1 + (plane * 7 + camera * 31) % 255, dtype=np.uint8)


class Sender(PlainCamera):
    """A camera that does not wait for anybody: blocks [0, n), then silence; `lost` never leave it."""

    def __init__(self, number: int, blocks: int, lost: frozenset[int] = frozenset(), pause_s: float = 0.0):
        super().__init__()
        self.id, self.layout = IDS[number], LAYOUT
        self.number, self.blocks, self.lost, self.pause_s = number, blocks, lost, pause_s
        self.sent = self.dropped = 0
        self.before_block = lambda number: None

    def ensure_ready(self) -> None:
        self.sent = 0

    def ensure_stopped(self) -> None:
        pass

    def read_block(self, timeout_s: float) -> Block | None:
        while self.sent in self.lost:
            self.sent += 1
            self.dropped += BLOCK_PLANES
        if self.sent >= self.blocks:
            return None
        self.before_block(self.sent)
        time.sleep(self.pause_s)
        first = self.sent * BLOCK_PLANES
        packed = np.stack([plane_bytes(self.number, first + k) for k in range(BLOCK_PLANES)])
        self.sent += 1
        return Block(self.sent - 1, first, round(first * 1e9 / RATE_HZ), LAYOUT, packed, 1, self.dropped)


class Pulse:
    kind = "line"
    period_s = None

    def fire(self) -> None:
        pass


@pytest.fixture
def capture(tmp_path, monkeypatch):
    def run(senders, planes, *, file=DirectFile, use=None, progress=None, **how) -> Manifest:
        monkeypatch.setattr(writer_module, "StreamSpace", functools.partial(StreamSpace, open_file=file))
        ids = [s.id for s in senders]
        rig = Rig("bench", RATE_HZ, tuple(Camera(i, 400, 250, 450, 450, 200, 125, Transform.identity()) for i in ids))
        with RecordingWriter(tmp_path / "rec", rig, use or DiskUse()) as recording:
            report = progress or (lambda fraction, message: None)
            waits = not issubclass(file, SlowFile)  # on a shared machine any disk is slow now and then
            record_session(senders, Pulse(), planes, recording, report, waits=waits, **how)
            return recording.commit(recording.entries(), "line")

    return run


def check(folder) -> None:
    """The files verify, every plane offered is in the file as it was sent or zero and listed: exactly."""
    recording = Recording.open(folder)
    assert verify(folder) == []
    for camera_id in recording.camera_ids:
        entry = recording.manifest.camera(camera_id)
        lost = np.zeros(entry.planes, dtype=bool)
        for gap in entry.gaps:
            lost[gap.first_plane : gap.first_plane + gap.planes] = True
        assert entry.written + sum(entry.drops.values()) == entry.planes
        assert lost.sum() == sum(entry.drops.values())
        for plane, packed in enumerate(recording.stream(camera_id).packed):
            expected = 0 if lost[plane] else plane_bytes(IDS.index(camera_id), plane)
            assert (packed == expected).all(), (camera_id, plane)


class SlowFile(DirectFile):
    def write(self, data, offset):
        time.sleep(0.02)
        super().write(data, offset)


def test_a_slow_disk_costs_planes_that_are_counted_exactly(tmp_path, capture):
    senders = [Sender(number, 400, frozenset({3, 150, 151})) for number in range(3)]
    manifest = capture(senders, 400 * BLOCK_PLANES, file=SlowFile, use=DiskUse(ring_bytes=4 << 20))
    assert manifest.status == "complete"
    for camera in manifest.cameras:
        assert camera.planes == 400 * BLOCK_PLANES
        assert camera.drops["ring"] > 0
        assert camera.drops["device"] == 3 * BLOCK_PLANES
    check(tmp_path / "rec")


def test_without_a_slow_disk_only_the_devices_own_losses_are_listed(tmp_path, capture):
    manifest = capture([Sender(0, 50, frozenset({7})), Sender(1, 50)], 50 * BLOCK_PLANES)
    assert [camera.drops for camera in manifest.cameras] == [
        {"device": BLOCK_PLANES, "link": 0, "ring": 0, "disk": 0},
        {"device": 0, "link": 0, "ring": 0, "disk": 0},
    ]
    check(tmp_path / "rec")


class FailingFile(DirectFile):
    """Refuses cam01's bytes from the third megabyte on."""

    def write(self, data, offset):
        if self.path.name == "cam01.dat" and offset >= 3 << 20:
            raise OSError(errno.ENOSPC, "No space left on device")
        super().write(data, offset)


def test_what_a_disk_refuses_is_lost_in_its_layer_and_the_run_ends(tmp_path, capture):
    senders = [Sender(number, 2_000, pause_s=0.001) for number in range(3)]
    manifest = capture(senders, 2_000 * BLOCK_PLANES, file=FailingFile, use=DiskUse(ring_bytes=4 << 20))
    assert manifest.status == "incomplete"
    assert "cam01.dat: the disk is full or failing (No space left on device)" in manifest.reason
    assert manifest.camera("cam01").drops["disk"] > 0
    assert manifest.camera("cam01").written == (3 << 20) // LAYOUT.plane_bytes
    assert sum(manifest.camera("cam00").drops.values()) == 0
    assert len({camera.planes for camera in manifest.cameras}) == 1
    assert all(sender.sent < 2_000 for sender in senders)
    check(tmp_path / "rec")


def test_a_file_that_may_not_grow_ends_where_it_is_whole(tmp_path, capture):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3_500_000, hard))
    try:
        senders = [Sender(number, 2_000, pause_s=0.001) for number in range(2)]
        manifest = capture(senders, 2_000 * BLOCK_PLANES, use=DiskUse(ring_bytes=4 << 20))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "cam00.dat: the disk is full or failing (File too large), " in manifest.reason
    assert "planes behind the file's end are lost" in manifest.reason
    assert [camera.written for camera in manifest.cameras] == [(3 << 20) // LAYOUT.plane_bytes] * 2
    check(tmp_path / "rec")


def test_the_disk_guard_ends_the_run_before_the_disk_is_full(tmp_path, capture, monkeypatch):
    left = iter([10 << 30] * 4)
    monkeypatch.setattr(writer_module, "free_bytes", lambda folder: next(left, 900 << 20))
    senders = [Sender(number, 100_000, pause_s=0.001) for number in range(2)]
    manifest = capture(senders, None, use=DiskUse(keep_free_bytes=850 << 20))
    assert manifest.reason == f"the disk had {900 << 20} bytes free, {850 << 20} are kept free"
    assert all(sum(camera.drops.values()) == 0 for camera in manifest.cameras)
    check(tmp_path / "rec")


def test_a_run_until_stopped_ends_all_cameras_at_one_plane(tmp_path, capture):
    control = Control()
    senders = [Sender(number, 100_000, pause_s=0.0005) for number in range(3)]
    senders[1].before_block = lambda number: control.stop.set() if number == 60 else None
    manifest = capture(senders, None, control=control)
    assert manifest.status == "complete"
    assert {camera.planes for camera in manifest.cameras} == {manifest.cameras[0].planes}
    assert manifest.cameras[0].planes >= 60 * BLOCK_PLANES
    check(tmp_path / "rec")


def test_a_pre_trigger_keeps_what_was_before_it(tmp_path, capture):
    control, pre = Control(), 100
    senders = [Sender(number, 100_000, pause_s=0.0005) for number in range(3)]
    senders[0].before_block = lambda number: control.save.set() if number == 1500 else None
    manifest = capture(senders, 5_000, pre_planes=pre, control=control)
    assert manifest.status == "complete"
    assert {camera.planes for camera in manifest.cameras} == {5_000}
    assert manifest.trigger_plane == pre
    recording = Recording.open(tmp_path / "rec")
    assert verify(tmp_path / "rec") == []
    first = [recording.stream(i).packed[0, 0] for i in IDS]
    candidates = [p for p in range(0, 100_000) if (plane_bytes(0, p)[0] == first[0])]
    assert any(all(plane_bytes(n, p)[0] == first[n] for n in range(3)) for p in candidates)  # one plane for all
    for number, camera_id in enumerate(IDS):
        packed = recording.stream(camera_id).packed[:, 0].astype(int)
        assert (np.diff(packed) % 255 == 7).all(), number  # no plane twice, none left out


def test_a_pre_trigger_that_never_comes_keeps_nothing(tmp_path, capture):
    control = Control()
    senders = [Sender(0, 100_000, pause_s=0.0005)]
    senders[0].before_block = lambda number: control.stop.set() if number == 100 else None
    with pytest.raises(StoppedError, match="stopped before it was told to save"):
        capture(senders, None, pre_planes=50, control=control)
    assert list(tmp_path.iterdir()) == []


def test_a_save_that_the_stop_behind_it_overtook_is_kept_whole(tmp_path, capture):
    control = Control()
    senders = [Sender(number, 100_000, pause_s=0.0005) for number in range(3)]

    def stop_and_save(number):
        if number == 100:
            control.stop.set()
            threading.Timer(0.1, control.save.set).start()

    senders[0].before_block = stop_and_save
    capture(senders, None, pre_planes=50, control=control)
    manifest = read_any_manifest(tmp_path / "rec")
    assert (manifest.status, manifest.trigger_plane) == ("complete", 50)
    assert len({camera.planes for camera in manifest.cameras}) == 1


class SavedTooLate(threading.Event):
    """An order to save that comes between the first look for it after `stop` and the next."""

    def __init__(self, stop):
        super().__init__()
        self.stop, self.looks = stop, 0

    def is_set(self):
        self.looks += self.stop.is_set()
        return self.looks > 1

    def wait(self, timeout=None):
        return self.is_set()


def test_a_save_after_the_end_begins_nothing(tmp_path, capture):
    stop = threading.Event()
    control = Control(stop=stop, save=SavedTooLate(stop))
    senders = [Sender(number, 100_000, pause_s=0.0005) for number in range(3)]
    senders[0].before_block = lambda number: control.stop.set() if number == 100 else None
    with pytest.raises(StoppedError, match="stopped before it was told to save"):
        capture(senders, None, pre_planes=50, control=control)
    assert list(tmp_path.iterdir()) == []


def test_the_manifest_says_what_is_going_on(tmp_path, capture):
    seen = set()
    fractions = []

    def look(fraction, message):
        seen.add(read_any_manifest(tmp_path / "rec.partial").status)
        fractions.append(message)

    class Armed(Sender):
        def ensure_ready(self):
            seen.add(read_any_manifest(tmp_path / "rec.partial").status)

    manifest = capture([Armed(0, 600, pause_s=0.001)], 600 * BLOCK_PLANES, progress=look)
    assert seen == {"armed", "recording"}
    assert manifest.status == "complete"
    assert any("1 of 1 cameras good" in message for message in fractions)
    check(tmp_path / "rec")


def test_progress_names_the_camera_that_loses_planes(tmp_path, capture):
    said = []
    senders = [Sender(0, 300, frozenset({5})), Sender(1, 300, pause_s=0.001)]
    capture(senders, 300 * BLOCK_PLANES, progress=lambda fraction, message: said.append(message))
    assert any(f"1 of 2 cameras good, cam00 {BLOCK_PLANES} lost (device)" in message for message in said)


def test_blocks_sent_twice_are_taken_once_and_a_counter_that_begins_anew_is_a_failure(tmp_path, capture):
    class Repeating(Sender):
        def read_block(self, timeout_s):
            block = super().read_block(timeout_s)
            if block and block.block_id == 20 and not self.lost:
                self.sent, self.lost = 15, frozenset({-1})
            return block

    manifest = capture([Repeating(0, 50)], 50 * BLOCK_PLANES)
    assert manifest.cameras[0].written == 50 * BLOCK_PLANES
    check(tmp_path / "rec")


def test_a_counter_that_begins_anew_ends_its_camera(tmp_path, capture):
    class Restarting(Sender):
        def read_block(self, timeout_s):
            if self.sent == 200:
                self.sent = 0
            return super().read_block(timeout_s)

    manifest = capture([Restarting(0, 1000), Sender(1, 1000)], 1000 * BLOCK_PLANES)
    assert manifest.reason.startswith("cam00: found plane 0, expected 1600; its counter began anew")
    assert [camera.written for camera in manifest.cameras] == [1600, 8000]
    check(tmp_path / "rec")


class UnalignedFile(DirectFile):
    """On a file system that knows no O_DIRECT."""

    def __init__(self, path):
        super().__init__(path)
        self._buffer_writes()


def test_a_file_system_without_direct_writes_is_used_and_named(tmp_path, capture):
    manifest = capture([Sender(0, 50)], 50 * BLOCK_PLANES, file=UnalignedFile)
    assert manifest.direct_io is False
    check(tmp_path / "rec")


def test_a_stop_from_another_thread_is_heard(tmp_path, capture):
    control = Control()
    threading.Timer(0.3, control.stop.set).start()
    manifest = capture([Sender(0, 1_000_000, pause_s=0.001)], None, control=control)
    assert manifest.cameras[0].planes > 0
    check(tmp_path / "rec")
