"""A recording that was made compact is the same recording, and a kill at any moment leaves it whole."""

import dataclasses
import errno
import hashlib
import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from acquisition.errors import BadRecordingError, DiskError
from acquisition.recording import compaction
from acquisition.recording.compaction import compact, restore
from acquisition.recording.finalise import finalise
from acquisition.recording.manifest import Gap, dump_manifest
from acquisition.recording.reader import Recording, read_manifest
from acquisition.recording.verify import verify
from acquisition.recording.writer import RecordingWriter
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

LAYOUT = PlaneLayout(9, 5)  # 45 pixels: neither rows nor planes are whole bytes
IDS = ("cam00", "cam01", "cam02")
PLANES = {"cam00": 1003, "cam01": 1, "cam02": 80}  # three blocks and a tail of no whole byte; one plane; a whole block
STEPS = ("open", "os.rename", "os.remove")  # audited events: between two of them nothing on the disk changes its name


def planes_of(camera_id: str) -> np.ndarray:
    bits = np.random.default_rng(int(camera_id[3:])).random((PLANES[camera_id], 45)) < 0.2
    return np.packbits(bits, axis=1, bitorder="little")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recording of three streams of unlike length, with planes lost."""
    out = tmp_path_factory.mktemp("compact") / "rec"
    cameras = tuple(Camera(i, 9, 5, 8.0, 8.0, 4.5, 2.5, Transform.identity()) for i in IDS)
    with RecordingWriter(out, Rig("three", 20_000.0, cameras)) as recording:
        streams = [recording.stream(camera_id, LAYOUT) for camera_id in IDS]
        for stream in streams:
            planes = planes_of(stream.camera_id)
            stream.append(planes[:50])
            if len(planes) > 100:
                stream.append_lost([Gap(50, 30, "link")])
                stream.append(planes[80:])
            else:
                stream.append(planes[50:])
            stream.close()
        recording.commit(recording.entries(), "line")
    return out


@pytest.fixture
def rec(recorded, tmp_path):
    return Path(shutil.copytree(recorded, tmp_path / "rec"))


@pytest.fixture
def compacted(rec):
    compact(rec)
    return rec


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def bits_of(folder: Path) -> dict[str, bytes]:
    recording = Recording.open(folder)
    return {camera_id: np.asarray(recording.stream(camera_id).packed).tobytes() for camera_id in IDS}


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} - {"recording.json", "rig.toml"}


DATS, COMPACTS = ({f"{camera_id}{suffix}" for camera_id in IDS} for suffix in (".dat", ".compact"))


def test_a_compact_recording_is_the_same_recording(rec, recorded):
    manifest = compact(rec)
    assert names(rec) == COMPACTS
    assert verify(rec) == []
    assert read_manifest(rec) == manifest
    before = read_manifest(recorded)
    plain = tuple(dataclasses.replace(camera, compact=None) for camera in manifest.cameras)
    assert dataclasses.replace(manifest, cameras=plain) == before
    assert (
        bits_of(rec)
        == bits_of(recorded)
        == {camera.file[:5]: (recorded / camera.file).read_bytes() for camera in plain}
    )
    for camera in manifest.cameras:
        assert camera.stored_bytes == (rec / camera.stored_file).stat().st_size
        assert camera.bytes == (recorded / camera.file).stat().st_size
    assert [camera.compact.block_planes for camera in manifest.cameras] == [400] * 3
    here, there = (Recording.open(folder).stream("cam00") for folder in (rec, recorded))
    for first, last in ((0, 0), (399, 401), (1000, 1003), (0, 1003)):
        np.testing.assert_array_equal(here.planes(first, last), there.planes(first, last))
        np.testing.assert_array_equal(here.counts(first, last), there.counts(first, last))
    assert finalise(rec).manifest == manifest, "a compact recording is a finished one"


def test_the_way_back_restores_every_byte(compacted, recorded):
    restore(compacted)
    assert contents(compacted) == contents(recorded)


def test_older_programs_are_told_to_update_and_others_are_spared(compacted, recorded):
    assert json.loads((compacted / "recording.json").read_text())["schema_version"] == 2
    plain = json.loads((recorded / "recording.json").read_text())
    assert plain["schema_version"] == 1
    assert not [camera for camera in plain["cameras"] if "compact" in camera]


def test_a_camera_without_a_plane_stays_as_it_is(rec):
    manifest = read_manifest(rec)
    nothing = hashlib.sha256().hexdigest()
    empty = dataclasses.replace(manifest.cameras[1], planes=0, block_digests=(), sha256=nothing)
    changed = dataclasses.replace(manifest, cameras=(manifest.cameras[0], empty, manifest.cameras[2]))
    (rec / "recording.json").write_text(dump_manifest(changed))
    (rec / "cam01.dat").write_bytes(b"")
    compact(rec)
    assert names(rec) == {"cam00.compact", "cam01.dat", "cam02.compact"}
    assert verify(rec) == []
    with pytest.raises(BadRecordingError, match="compact already"):
        compact(rec)


def killed(folder: Path, work, step: int) -> bool:
    """Do `work` in a process that dies before its `step`th event on files of `folder`; False where it has fewer."""
    child = os.fork()
    if not child:
        left = step

        def die(event: str, arguments: tuple) -> None:
            nonlocal left
            if event in STEPS and str(arguments[0]).startswith(str(folder)):
                left -= 1
                if left < 0:
                    os._exit(9)

        try:
            sys.addaudithook(die)
            work(folder)
            os._exit(0)
        finally:
            os._exit(1)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, 9)
    return code == 9


@pytest.mark.parametrize("way", [compact, pytest.param(restore, marks=pytest.mark.slow)])
def test_killed_at_any_step_the_recording_is_whole_and_a_second_call_finishes(recorded, tmp_path, way):
    start = Path(shutil.copytree(recorded, tmp_path / "start"))
    if way is restore:
        compact(start)
    good, step, forms = bits_of(recorded), 0, set()
    while True:
        rec = Path(shutil.copytree(start, tmp_path / f"rec{step}"))
        if not killed(rec, way, step):
            break
        forms.add(tuple(bool(camera.compact) for camera in read_manifest(rec).cameras))
        assert verify(rec) == []
        assert bits_of(rec) == good
        with_left_overs = names(rec) not in (DATS, COMPACTS)
        try:
            way(rec)
        except BadRecordingError as error:
            assert not with_left_overs
            assert "compact" in str(error)  # noqa: PT017 (it had all been done)
        assert names(rec) == (COMPACTS if way is compact else DATS)
        assert bits_of(rec) == good
        assert verify(rec) == []
        step += 1
    assert step > 30
    assert len(forms) == 4, "kills fell before, between and behind all three cameras"


def test_an_interrupted_call_may_be_turned_round(recorded, tmp_path):
    for step in range(8, 40, 3):
        rec = Path(shutil.copytree(recorded, tmp_path / f"rec{step}"))
        assert killed(rec, compact, step)
        try:
            restore(rec)
        except BadRecordingError:
            assert names(rec) == DATS
        assert contents(rec) == contents(recorded)


def test_each_form_is_on_the_disk_before_the_manifest_names_it_and_the_other_goes_last(rec, monkeypatch):
    happened = []

    def noting(name, place):
        real = getattr(os, name)

        def call(*arguments, **options):
            happened.append((name, place(*arguments)))
            return real(*arguments, **options)

        monkeypatch.setattr(os, name, call)

    noting("fsync", lambda handle: Path(f"/proc/self/fd/{handle}").readlink().name)
    noting("replace", lambda _, target: Path(target).name)
    noting("unlink", lambda path, **_: Path(path).name)
    compact(rec)
    assert len(happened) == 3 * 9
    for camera_id, steps in zip(IDS, (happened[:9], happened[9:18], happened[18:]), strict=True):
        made, manifest = (f".{name}.{os.getpid()}.partial" for name in (f"{camera_id}.compact", "recording.json"))
        assert steps == [
            *[("fsync", made)] * 2,
            ("replace", f"{camera_id}.compact"),
            ("fsync", "rec"),
            ("fsync", manifest),
            ("replace", "recording.json"),
            ("fsync", "rec"),
            ("unlink", f"{camera_id}.dat"),
            ("fsync", "rec"),
        ]


def test_what_an_interrupted_call_left_is_removed_and_other_files_are_not(compacted):
    for name in (".cam00.compact.77.partial", ".recording.json.77.partial", "cam02.dat", "notes.txt"):
        (compacted / name).write_bytes(b"torn")
    compact(compacted)
    assert names(compacted) == {*COMPACTS, "notes.txt"}
    with pytest.raises(BadRecordingError, match="found it compact already"):
        compact(compacted)
    (compacted / "cam01.dat").write_bytes(b"torn")
    restore(compacted)
    (compacted / "cam01.compact").write_bytes(b"torn")
    restore(compacted)
    assert names(compacted) == {*DATS, "notes.txt"}


def test_a_reader_that_was_open_before_reads_on(rec, recorded):
    recording = Recording.open(rec)
    early = recording.stream("cam02")
    compact(rec)
    np.testing.assert_array_equal(early.window(0, 80), planes_of("cam02"))
    np.testing.assert_array_equal(recording.stream("cam02").window(0, 80), planes_of("cam02"))
    late = recording.stream("cam00")
    restore(rec)
    assert np.asarray(late.packed).tobytes() == (recorded / "cam00.dat").read_bytes()


def refused(way, folder, message, kind=BadRecordingError):
    """Let `way` be refused with one line that has `message`; nothing in the folder changes."""
    before = contents(folder) if folder.is_dir() else None
    with pytest.raises(kind, match=message) as caught:
        way(folder)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2
    assert (contents(folder) if folder.is_dir() else None) == before


def test_what_is_not_to_be_done_is_refused(rec, compacted, tmp_path):
    refused(compact, compacted, r"rec: found it compact already, expected `\.dat` files; leave it, or --undo")
    restore(compacted)
    refused(restore, rec, "rec: found no compact file")
    (tmp_path / "empty").mkdir()
    for way in (compact, restore):
        refused(way, tmp_path / "nowhere", "expected a recording folder")
        refused(way, tmp_path / "empty", "expected a recording folder")


def test_a_damaged_recording_is_refused_in_either_form(rec):
    for way, name in ((compact, "cam00.dat"), (restore, "cam00.compact")):
        data = bytearray((rec / name).read_bytes())
        data[1000] ^= 4
        (rec / name).write_bytes(data)
        refused(way, rec, rf"rec: found it damaged: {name}: block \d: .* expected a sound recording; verify it")
        data[1000] ^= 4
        (rec / name).write_bytes(data)
        way(rec)


def test_a_recording_that_is_being_written_is_refused(tmp_path):
    rig = Rig("one", 20_000.0, (Camera("a", 9, 5, 8.0, 8.0, 4.5, 2.5, Transform.identity()),))
    with RecordingWriter(tmp_path / "rec", rig) as recording:
        recording.stream("a", LAYOUT)
        refused(compact, tmp_path / "rec", r"rec\.partial: is being recorded now; wait until that has ended")
        recording.mark("armed", "line")
        refused(compact, tmp_path / "rec.partial", "found it armed, expected a finished recording")
        recording.folder.rename(tmp_path / "kept")
        recording.folder.mkdir()
    (tmp_path / "kept").rename(tmp_path / "rec.partial")
    refused(compact, tmp_path / "rec", r"rec: found only rec\.partial, expected a finished recording; `finalise` it")


def test_a_second_call_beside_the_first_is_refused(rec, monkeypatch):
    monkeypatch.setattr(
        compaction, "verify", lambda *_: refused(restore, rec, "rec: is being made compact or plain now") or []
    )
    compact(rec)
    assert names(rec) == COMPACTS


@pytest.mark.parametrize("way", [compact, restore])
def test_a_disk_without_room_is_refused_before_anything_is_done(rec, monkeypatch, way):
    if way is restore:
        compact(rec)
    needed = 1003 * 6 // 2 if way is compact else 0
    monkeypatch.setattr(compaction, "free_bytes", lambda _: (1 << 20) + needed - 1)
    refused(way, rec, r"rec: found \d+ bytes free, expected at least \d+; free some space", DiskError)


@pytest.mark.parametrize("way", [compact, restore])
def test_a_disk_that_fills_up_leaves_the_recording_as_it_was(rec, monkeypatch, way):
    if way is restore:
        compact(rec)

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(compaction, "_to_the_disk", full)
    refused(way, rec, r"cam00\.(dat|compact): cannot be written \(No space left on device\)", DiskError)


@pytest.mark.parametrize("way", [compact, restore])
def test_what_does_not_read_back_is_thrown_away(rec, monkeypatch, way):
    if way is restore:
        compact(rec)
    flush = compaction._to_the_disk

    def rotten(path):
        flush(path)
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 1
        path.write_bytes(data)

    monkeypatch.setattr(compaction, "_to_the_disk", rotten)
    refused(way, rec, "cam00", (BadRecordingError, DiskError))


def test_one_name_for_two_things_is_refused(rec):
    manifest = rec / "recording.json"
    manifest.write_text(manifest.read_text().replace('"cam02.dat"', '"cam00.compact"'))
    (rec / "cam02.dat").rename(rec / "cam00.compact")
    refused(compact, rec, r"rec: found cam00\.compact for two things, expected a file of its own for each camera")


def test_damage_of_a_compact_file_is_named_by_camera_and_block(compacted):
    entry = read_manifest(compacted).camera("cam00")
    path, first = compacted / entry.stored_file, entry.compact.block_bytes[0]
    data = bytearray(path.read_bytes())
    data[first + 99] ^= 8
    path.write_bytes(data)
    [damaged] = verify(compacted)
    assert str(damaged).startswith("cam00.compact: block 1: found a block that cannot be decoded")
    stream = Recording.open(compacted).stream("cam00")
    stream.window(0, 400)
    with pytest.raises(
        BadRecordingError, match=r"cam00\.compact: block 1 \(planes 400 to 799\): found a block"
    ) as caught:
        stream.window(399, 401)
    assert "\n" not in str(caught.value)
    path.write_bytes(data[:-1])
    [damaged] = verify(compacted)
    assert str(damaged) == f"cam00.compact: found {len(data) - 1} bytes, expected {len(data)}"
    with pytest.raises(BadRecordingError, match=r"cam00\.compact: found \d+ bytes, expected \d+; verify the recording"):
        Recording.open(compacted).stream("cam00")
    path.unlink()
    [damaged] = verify(compacted)
    assert str(damaged) == "cam00.compact: cannot be read (No such file or directory)"


def test_planes_that_decode_but_are_others_are_found(compacted):
    manifest = read_manifest(compacted)
    entry = manifest.camera("cam00")

    def told(**changes) -> list[str]:
        cameras = (dataclasses.replace(entry, **changes), *manifest.cameras[1:])
        (compacted / "recording.json").write_text(dump_manifest(dataclasses.replace(manifest, cameras=cameras)))
        return list(map(str, verify(compacted)))

    digests = (*entry.block_digests[:2], "0" * 16, *entry.block_digests[3:])
    assert told(block_digests=digests) == ["cam00.compact: block 2: planes 160 to 239 are not the recorded ones"]
    assert told(sha256="ab") == ["cam00.compact: its SHA-256 is not the recorded one"]


def test_a_recording_without_sha256_gets_them(rec):
    text = (rec / "recording.json").read_text()
    document = json.loads(text)
    for camera in document["cameras"]:
        camera["sha256"] = None
    (rec / "recording.json").write_text(json.dumps(document))
    compact(rec)
    restore(rec)
    assert (rec / "recording.json").read_text() == text


def test_the_command(spike4dgs, rec, recorded):
    code, out, err = spike4dgs("compact", rec, "--json")
    assert code == 0
    assert err[-1].startswith("compact 100%")
    document = json.loads(out)
    stored = sum(path.stat().st_size for path in rec.glob("*.compact"))
    assert {name: document[name] for name in ("recording", "compact", "bytes", "stored_bytes")} == {
        "recording": str(rec), "compact": True, "bytes": 6 * sum(PLANES.values()), "stored_bytes": stored,
    }  # fmt: skip
    assert document["ratio"] == document["bytes"] / stored
    assert document["cameras"]["cam01"]["planes"] == 1
    assert spike4dgs("verify", rec)[1].endswith("rec: sound\n")
    code, out, err = spike4dgs("compact", rec)
    assert (code, out) == (2, "")
    assert err[-1] == f"spike4dgs: {rec}: found it compact already, expected `.dat` files; leave it, or --undo"
    code, out, _ = spike4dgs("compact", rec, "--undo")
    assert (code, out) == (0, f"{rec}: 0.0 MB, for 0.0 MB of planes (1.00 times)\n")
    assert contents(rec) == contents(recorded)
    (rec / "cam00.dat").write_bytes(b"")
    code, _, err = spike4dgs("compact", rec)
    assert code == 2
    assert "found it damaged: cam00.dat: block 0: planes 0 to 79 are not the recorded ones and 13 more" in err[-1]


def test_images_and_replays_of_a_compact_recording_are_the_same(spike4dgs, small_recording, tmp_path):
    rec = Path(shutil.copytree(small_recording, tmp_path / "rec"))
    compact(rec)
    for method in ("tfi", "tfp", "slope", "adaptive", "interpolated"):
        made = []
        for number, source in enumerate((small_recording, rec)):
            out = tmp_path / f"{method}{number}"
            assert spike4dgs("images", source, "--method", method, "--ticks", "20:110:40", "--out", out)[0] == 0
            made.append({path.relative_to(out): path.read_bytes() for path in out.rglob("*.npy")})
        assert made[0] == made[1]
        assert made[0]
    copied = spike4dgs(
        *("record", "--devices", f"replay:{rec}", "--rig", rec / "rig.toml", "--ticks", 128, "--out", tmp_path / "copy")
    )
    assert copied[0] == 0
    for path in small_recording.glob("*.dat"):
        assert (tmp_path / "copy" / path.name).read_bytes() == path.read_bytes()
