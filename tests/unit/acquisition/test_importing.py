import hashlib
import json
import math

import numpy as np
import pytest

from acquisition.errors import BadRecordingError
from acquisition.recording.importing import ImportOptions, import_recording
from acquisition.recording.manifest import Conversion
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
    layout = Recording.open(tmp_path / "rec").manifest.camera("cam00").layout
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


def one_camera(tmp_path, width, height):
    camera = {"camera_id": "cam00", "transform_matrix": np.eye(4).tolist()}
    path = tmp_path / "one.json"
    path.write_text(json.dumps({"fl_x": 45.0, "w": width, "h": height, "frames": [camera]}))
    return path


def test_rows_with_a_header_are_kept_bit_for_bit(tmp_path):
    data = np.random.default_rng(2).bytes(5 * 416 * 250 // 8)
    (tmp_path / "a.dat").write_bytes(data)
    options = ImportOptions(20_000.0, format="vidar416")
    import_recording([str(tmp_path / "a.dat")], one_camera(tmp_path, 400, 250), tmp_path / "rec", options)
    assert (tmp_path / "rec/cam00.dat").read_bytes() == data
    assert verify(tmp_path / "rec") == []
    stream = Recording.open(tmp_path / "rec").stream("cam00")
    bits = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little").reshape(5, 250, 416)
    np.testing.assert_array_equal(stream.planes(0, 5), bits[:, ::-1, :400])


def test_an_m1k40_stream_is_decoded_and_the_manifest_says_so(tmp_path):
    planes = (np.random.default_rng(3).random((4, 1000, 1000)) < 0.2).astype(np.uint8)
    written = m1k40_bytes(planes)
    data = np.delete(written, [2500, 2501], axis=0).tobytes()[640:]
    (tmp_path / "a.dat").write_bytes(data)
    options, doubts = ImportOptions(20_000.0, format="m1k40"), []
    cameras = one_camera(tmp_path, 1000, 1000)
    import_recording([str(tmp_path / "a.dat")], cameras, tmp_path / "rec", options, warn=doubts.append)
    assert doubts == ["cam00: 2 segments are missing and will be zero, in the planes 0"]
    recording = Recording.open(tmp_path / "rec")
    conversion = recording.manifest.camera("cam00").conversion
    assert conversion == Conversion("m1k40", hashlib.sha256(data).hexdigest(), 128_000 - 640, ((0, 2),))
    expected = planes[1:].copy()
    expected[0, 250] = 0  # the two halves of a row
    np.testing.assert_array_equal(recording.stream("cam00").planes(0, 3), expected)
    assert verify(tmp_path / "rec") == []


def test_streams_that_began_apart_are_cut_to_one_instant(tmp_path, transforms, dats):
    began = {camera_id: (0.0, 0.1) for camera_id in IDS} | {"cam01": (-7.3, 0.2), "cam12": (15.4, 0.0)}
    names = [str(d) for d in dats]
    import_recording(names, transforms(), tmp_path / "rec", OPTIONS, align=lambda streams: began)
    recording = Recording.open(tmp_path / "rec")
    assert verify(tmp_path / "rec") == []
    for camera_id, dat in zip(IDS, dats, strict=True):
        left_out = {"cam01": 23, "cam12": 0}.get(camera_id, 15)
        assert recording.stream(camera_id).packed.tobytes() == dat.read_bytes()[130 * left_out :]
        entry = recording.manifest.camera(camera_id)
        planes, sd = began[camera_id]
        assert entry.skew_s == pytest.approx((planes + left_out - 15.4) / 20_000)
        assert abs(entry.skew_s) <= 0.5 / 20_000
        assert entry.skew_sd_s == pytest.approx(sd / 20_000)
    began["cam22"] = (200.0, 0.0)
    with pytest.raises(BadRecordingError, match=r"cam00: found 90 planes, all sent before the last camera began"):
        import_recording(names, transforms(), tmp_path / "none", OPTIONS, align=lambda streams: began)
    assert not (tmp_path / "none").exists()


def test_a_stream_that_is_cut_keeps_its_partial_plane(tmp_path, transforms, dats):
    dats[6].write_bytes(dats[6].read_bytes()[:-7])
    began = {camera_id: (float(camera_id == "cam00"), 0.0) for camera_id in IDS}
    options = ImportOptions(20_000.0, allow_partial=True)
    import_recording([str(d) for d in dats], transforms(), tmp_path / "rec", options, align=lambda streams: began)
    entry = Recording.open(tmp_path / "rec").manifest.camera("cam20")
    assert (entry.planes, entry.partial_bytes) == (PLANES - 2, 123)


def m1k40_bytes(planes):
    names = [(500, 0), *((n, c) for c in range(4) for n in range(1, 501) if (n, c % 3) != (500, 0)), (500, 3)]
    bits = np.zeros((len(planes), 2000, 512), dtype=np.uint8)
    bits[:, :, :500] = planes.reshape(len(planes), 2000, 500)
    trailer = np.array([line << 4 | channel << 14 for line, channel in names])
    bits[:, :, 500:] = trailer[:, None] >> np.arange(4, 16) & 1
    return np.packbits(bits, axis=2, bitorder="little").reshape(-1, 64)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"format": "m1k40", "row_order": "top"}, "the format fixes them"),
        ({"format": "m2k"}, "vidar416"),
    ],
)
def test_formats_that_cannot_be_are_refused(change, word):
    with pytest.raises(BadRecordingError, match=word):
        ImportOptions(20_000.0, **change)


def test_an_m1k40_camera_of_another_size_and_a_cut_file_are_refused(tmp_path):
    planes = (np.random.default_rng(3).random((3, 1000, 1000)) < 0.2).astype(np.uint8)
    (tmp_path / "a.dat").write_bytes(m1k40_bytes(planes).tobytes()[:-100])
    name = [str(tmp_path / "a.dat")]
    options, cameras = ImportOptions(2e4, size=(400, 250), format="m1k40"), one_camera(tmp_path, 400, 250)
    with pytest.raises(BadRecordingError, match="cam00: found a camera of 400x250"):
        import_recording(name, cameras, tmp_path / "rec", options)
    cameras = one_camera(tmp_path, 1000, 1000)
    with pytest.raises(BadRecordingError, match=r"cam00: .*127900 bytes behind the last of 2 whole planes"):
        import_recording(name, cameras, tmp_path / "rec", ImportOptions(2e4, format="m1k40"))
    import_recording(name, cameras, tmp_path / "rec", ImportOptions(2e4, format="m1k40", allow_partial=True))
    assert Recording.open(tmp_path / "rec").manifest.camera("cam00").partial_bytes == 127_900
