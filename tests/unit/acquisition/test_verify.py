import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition.errors import BadRecordingError
from acquisition.recording.verify import Damaged, verify
from acquisition.recording.writer import RecordingWriter
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

LAYOUT = PlaneLayout(9, 5)
BLOCK = 80 * LAYOUT.plane_bytes


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    cameras = tuple(Camera(i, 9, 5, 8.0, 8.0, 4.5, 2.5, Transform.identity()) for i in ("cam00", "cam01"))
    out = tmp_path_factory.mktemp("verify") / "rec"
    planes = np.random.default_rng(0).integers(0, 256, (200, LAYOUT.plane_bytes), dtype=np.uint8)
    with RecordingWriter(out, Rig("pair", 20_000.0, cameras), 0) as recording:
        streams = [recording.stream(camera.id, LAYOUT) for camera in cameras]
        for stream in streams:
            stream.append(planes)
            stream.close()
        recording.commit([stream.entry() for stream in streams], "line")
    return out


@pytest.fixture
def damage(folder):
    before = {path: path.read_bytes() for path in folder.iterdir()}
    yield folder
    for path, data in before.items():
        path.write_bytes(data)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(st.integers(0, 200 * 6 * 8 - 1))
def test_one_flipped_bit_is_found_in_its_block(folder, bit):
    path = folder / "cam01.dat"
    good = path.read_bytes()
    bad = bytearray(good)
    bad[bit // 8] ^= 1 << bit % 8
    path.write_bytes(bad)
    try:
        [damaged] = verify(folder)
    finally:
        path.write_bytes(good)
    assert (damaged.file, damaged.block) == ("cam01.dat", bit // 8 // BLOCK)
    assert verify(folder) == []


def test_a_short_file_is_found(damage):
    path = damage / "cam00.dat"
    path.write_bytes(path.read_bytes()[: BLOCK + 5])
    found = verify(damage)
    assert [d.block for d in found] == [1, 2, None]
    assert str(found[-1]) == "cam00.dat: found 485 bytes, expected 1200"


def test_a_long_file_is_found(damage):
    path = damage / "cam00.dat"
    path.write_bytes(path.read_bytes() + b"\0")
    assert [str(d) for d in verify(damage)] == ["cam00.dat: found 1201 bytes, expected 1200"]


def test_a_missing_file_is_found(damage):
    (damage / "cam01.dat").unlink()
    assert verify(damage) == [Damaged("cam01.dat", None, "cannot be read (No such file or directory)")]


def test_a_changed_rig_is_found(damage):
    rig = damage / "rig.toml"
    rig.write_text(rig.read_text().replace("20000", "40000"))
    assert [d.file for d in verify(damage)] == ["rig.toml"]


def test_what_is_no_recording_is_refused(tmp_path):
    with pytest.raises(BadRecordingError, match="expected a recording folder"):
        verify(tmp_path)
