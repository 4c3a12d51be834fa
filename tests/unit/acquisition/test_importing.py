import json
import math

import numpy as np
import pytest

from acquisition.errors import BadRecordingError
from acquisition.recording.importing import ImportOptions, import_recording
from acquisition.recording.reader import Recording
from acquisition.recording.verify import verify
from rigs.errors import RigError
from rigs.toml import catalog_rig, dump_rig

WIDTH, HEIGHT, PLANES = 40, 26, 90
IDS = [f"cam{row}{column}" for row in range(3) for column in range(3)]
OPTIONS = ImportOptions(20_000.0)


@pytest.fixture
def transforms(tmp_path):
    def write(ids=IDS, **changes):
        frames = [{"camera_id": i, "transform_matrix": np.eye(4).tolist()} for i in ids]
        document = {"fl_x": 45.0, "w": WIDTH, "h": HEIGHT, "frames": frames, **changes}
        path = tmp_path / "transforms.json"
        path.write_text(json.dumps(document))
        return path

    return write


@pytest.fixture
def dats(tmp_path):
    rng = np.random.default_rng(1)
    paths = []
    for camera_id in IDS:
        paths.append(tmp_path / f"{camera_id}.dat")
        paths[-1].write_bytes(rng.bytes(PLANES * WIDTH * HEIGHT // 8))
    return paths


def assert_kept(out, dats):
    for camera_id, dat in zip(IDS, dats, strict=True):
        assert (out / f"{camera_id}.dat").read_bytes() == dat.read_bytes(), camera_id
    assert verify(out) == []


def test_plain_files_are_taken_in_the_rigs_order(tmp_path, transforms, dats):
    manifest = import_recording([str(d) for d in dats], transforms(), tmp_path / "rec", OPTIONS)
    assert_kept(tmp_path / "rec", dats)
    assert (manifest.trigger, manifest.tick_rate_hz) == ("import", 20_000)
    recording = Recording.open(tmp_path / "rec")
    assert (recording.planes, recording.rig.poses) == (PLANES, "calibrated")


def test_named_files_may_come_in_any_order(tmp_path, transforms, dats):
    named = [f"{i}={d}" for i, d in zip(IDS, dats, strict=True)]
    import_recording(named[::-1], transforms(), tmp_path / "rec", OPTIONS)
    assert_kept(tmp_path / "rec", dats)


def test_cameras_need_not_be_a_grid(tmp_path, transforms, dats):
    named = [f"left={dats[0]}", f"right={dats[1]}"]
    frames = [{"transform_matrix": np.eye(4).tolist()}] * 2
    import_recording(named, transforms(frames=frames), tmp_path / "rec", OPTIONS)
    assert Recording.open(tmp_path / "rec").camera_ids == ("left", "right")


def test_a_rig_file_keeps_its_flag_unless_told(tmp_path, dats):
    rig = catalog_rig("lab3x3").scaled(WIDTH, HEIGHT)
    (tmp_path / "r.toml").write_text(dump_rig(rig).replace(f'poses = "{rig.poses}"', 'poses = "nominal"'))
    names = [str(d) for d in dats]
    import_recording(names, tmp_path / "r.toml", tmp_path / "a", OPTIONS)
    import_recording(names, tmp_path / "r.toml", tmp_path / "b", ImportOptions(20_000.0, poses="calibrated"))
    assert Recording.open(tmp_path / "a").rig.poses == "nominal"
    assert Recording.open(tmp_path / "b").rig.poses == "calibrated"


def test_bit_and_row_order_go_into_the_layout(tmp_path, transforms, dats):
    options = ImportOptions(20_000.0, bit_order="msb", row_order="top")
    import_recording([str(d) for d in dats], transforms(), tmp_path / "rec", options)
    layout = Recording.open(tmp_path / "rec").layout("cam00")
    assert (layout.bit_order, layout.row_order) == ("msb", "top")
    assert_kept(tmp_path / "rec", dats)


def test_a_partial_plane_is_dropped_only_when_allowed(tmp_path, transforms, dats):
    whole = dats[6].read_bytes()
    dats[6].write_bytes(whole[:-7])
    names = [str(d) for d in dats]
    with pytest.raises(BadRecordingError, match=r"cam20: .*whole planes"):
        import_recording(names, transforms(), tmp_path / "rec", OPTIONS)
    assert not (tmp_path / "rec").exists()
    import_recording(names, transforms(), tmp_path / "rec", ImportOptions(20_000.0, allow_partial=True))
    recording = Recording.open(tmp_path / "rec")
    assert recording.manifest.camera("cam20").partial_bytes == 130 - 7
    assert (tmp_path / "rec/cam20.dat").read_bytes() == whole[:-130]
    assert recording.planes == PLANES - 1


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda d: d[:-1], "none for cam22"),
        (lambda d: [*d, d[0]], "no camera for"),
        (lambda d: [f"{i}={f}" for i, f in zip(IDS[:-1], d, strict=False)], "none for cam22"),
        (lambda d: [f"{i}={f}" for i, f in zip([*IDS[:-1], "cam33"], d, strict=True)], "none for cam22"),
        (lambda d: [f"cam00={d[0]}", f"cam00={d[1]}"], "cam00 more than once"),
        (lambda d: [f"cam00={d[0]}", d[1]], "for all of them or for none"),
        (lambda d: [*d[:4], d[4] + ".gone", *d[5:]], "cam11: "),
    ],
)
def test_streams_that_do_not_fit_the_cameras_are_refused(tmp_path, transforms, dats, change, word):
    with pytest.raises(BadRecordingError, match=word):
        import_recording(change([str(d) for d in dats]), transforms(), tmp_path / "rec", OPTIONS)
    assert not (tmp_path / "rec").exists()
    assert not (tmp_path / "rec.partial").exists()


def test_an_empty_stream_is_refused_by_name(tmp_path, transforms, dats):
    dats[3].write_bytes(b"")
    with pytest.raises(BadRecordingError, match=r"cam10: .*found 0 bytes"):
        import_recording([str(d) for d in dats], transforms(), tmp_path / "rec", OPTIONS)


@pytest.mark.parametrize("options", [ImportOptions(0.0), ImportOptions(math.nan), ImportOptions(2e4, size=(41, 27))])
def test_a_rate_or_size_that_cannot_be_is_refused(tmp_path, transforms, dats, options):
    with pytest.raises(RigError):
        import_recording([str(d) for d in dats], transforms(), tmp_path / "rec", options)
    assert not (tmp_path / "rec").exists()
