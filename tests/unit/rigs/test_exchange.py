import json
import math
import os
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigs.camera import Camera
from rigs.errors import RigError
from rigs.exchange.cameras import load_cameras
from rigs.exchange.colmap import dump_model
from rigs.exchange.nerfstudio import dump_transforms, load_frames, load_transforms
from rigs.rig import Rig
from rigs.toml import catalog_rig, dump_rig
from rigs.transform import Transform

numbers = st.floats(-1e3, 1e3)
lengths = st.floats(1e-3, 1e5)
quats = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: sum(x * x for x in q) > 1e-3)
poses = st.builds(Transform.from_quat_wxyz, quats, st.tuples(*[st.floats(-10, 10)] * 3))
sizes = st.integers(1, 5000)
fours = st.tuples(numbers, numbers, numbers, numbers)
fives = st.tuples(numbers, numbers, numbers, numbers, numbers.filter(bool))
lenses = st.fixed_dictionaries({"distortion": fours | fives}) | st.fixed_dictionaries(
    {"distortion": fours, "lens_model": st.just("fisheye")}
)


@st.composite
def camera_rows(draw) -> tuple[Camera, ...]:
    return tuple(
        Camera(
            f"cam0{column}",
            *(draw(sizes), draw(sizes), draw(lengths), draw(lengths), draw(numbers), draw(numbers), draw(poses)),
            **draw(lenses),
        )
        for column in range(draw(st.integers(1, 4)))
    )


def assert_same_cameras(found: tuple[Camera, ...], wanted: tuple[Camera, ...]) -> None:
    for a, b in zip(found, wanted, strict=True):
        assert (a.id, a.width, a.height, a.lens) == (b.id, b.width, b.height, b.lens)
        np.testing.assert_array_equal(a.K, b.K)
        np.testing.assert_allclose(a.cam_from_rig.matrix, b.cam_from_rig.matrix, rtol=0, atol=1e-12)


def write_model(folder: Path, cameras: tuple[Camera, ...]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, text in dump_model(cameras).items():
        (folder / name).write_text(text)
    return folder


def write_json(path: Path, document: object) -> Path:
    path.write_text(json.dumps(document))
    return path


def frame(camera_id: str | None = None, **changes) -> dict:
    named = {} if camera_id is None else {"camera_id": camera_id}
    return {"transform_matrix": np.eye(4).tolist()} | named | changes


TOP = {"fl_x": 45.0, "w": 40, "h": 26}
LAB = catalog_rig("lab3x3")


@given(cameras=camera_rows())
def test_transforms_round_trip(tmp_path_factory, cameras):
    path = tmp_path_factory.mktemp("nerfstudio") / "transforms.json"
    path.write_text(dump_transforms(cameras))
    assert_same_cameras(load_transforms(path), cameras)


@given(cameras=camera_rows())
def test_colmap_round_trip(tmp_path_factory, cameras):
    folder = write_model(tmp_path_factory.mktemp("colmap"), cameras)
    assert_same_cameras(load_cameras(folder, 20000).cameras, cameras)


def test_transforms_are_camera_to_world_in_opengl_axes(tmp_path):
    matrix = [[1, 0, 0, 0.2], [0, 1, 0, 0.3], [0, 0, 1, 1.8], [0, 0, 0, 1]]
    path = write_json(tmp_path / "transforms.json", TOP | {"frames": [frame("cam00", transform_matrix=matrix)]})
    (camera,) = load_transforms(path)
    np.testing.assert_allclose(camera.center, [0.2, 0.3, 1.8])
    np.testing.assert_allclose(camera.cam_from_rig.apply([0.2, 0.3, 0.8]), [0, 0, 1])  # -z of the world lies ahead
    np.testing.assert_allclose(camera.cam_from_rig.apply([0.2, 1.3, 1.8]), [0, -1, 0])  # y of the world points up


def test_intrinsics_default_and_those_in_a_frame_win(tmp_path):
    own = frame("cam01", fl_x=50.0, fl_y=51.0, cx=1.0, cy=2.0, w=8, h=6, k1=0.1, k2=0.2, p1=0.3, p2=0.4)
    path = write_json(tmp_path / "transforms.json", TOP | {"k1": 0.5, "frames": [frame("cam00"), own]})
    first, second = load_transforms(path)
    assert (first.width, first.height, first.fx, first.fy, first.cx, first.cy) == (40, 26, 45, 45, 20, 13)
    assert first.distortion == (0.5, 0, 0, 0)
    assert (second.width, second.height, second.fx, second.fy, second.cx, second.cy) == (8, 6, 50, 51, 1, 2)
    assert second.distortion == (0.1, 0.2, 0.3, 0.4)


def test_frames_without_camera_id_are_matched_by_order(tmp_path):
    path = write_json(tmp_path / "transforms.json", TOP | {"frames": [frame()] * 9})
    assert load_cameras(path, 20000).ids == LAB.ids
    assert [c.id for c in load_transforms(path, ids=[f"n{i}" for i in range(9)])] == [f"n{i}" for i in range(9)]
    path = write_json(tmp_path / "transforms.json", TOP | {"frames": [frame()] * 8})
    with pytest.raises(RigError, match="camera_id"):
        load_cameras(path, 20000)


def test_rotations_written_with_few_digits_are_mended_and_others_refused(tmp_path):
    rounded = np.round(np.linalg.inv(LAB.camera("cam00").cam_from_rig.matrix), 4)
    path = write_json(tmp_path / "transforms.json", TOP | {"frames": [frame(transform_matrix=rounded.tolist())]})
    rotation = load_transforms(path)[0].cam_from_rig.rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    rounded[0, 0] += 0.01
    path = write_json(tmp_path / "transforms.json", TOP | {"frames": [frame(transform_matrix=rounded.tolist())]})
    with pytest.raises(RigError, match=r"cam00: transform_matrix: .*not a rotation"):
        load_transforms(path)


def test_frames_carry_their_instant(tmp_path):
    frames = [frame("cam11", time=t) for t in (0.001, 0.0005)] + [frame(time=0)]
    path = write_json(tmp_path / "transforms.json", TOP | {"frames": frames})
    assert [(f.camera.id, f.instant_s) for f in load_frames(path)] == [
        ("cam11", 0.001),
        ("cam11", 0.0005),
        ("frame2", 0),
    ]
    path = write_json(tmp_path / "transforms.json", TOP | {"time": 0.5, "frames": [frame("cam11")]})
    with pytest.raises(RigError, match="frame 0: found no field time"):
        load_frames(path)


NAN_POSE = np.eye(4).tolist()
NAN_POSE[0][3] = math.nan


@pytest.mark.parametrize(
    ("document", "words"),
    [
        (TOP | {"frames": [frame("cam00"), frame("cam01", transform_matrix=NAN_POSE)]}, ["cam01", "transform_matrix"]),
        (TOP | {"frames": [frame("cam00", transform_matrix=[[1, 0], [0, 1]])]}, ["cam00", "4x4"]),
        (TOP | {"frames": [frame("cam00", transform_matrix=[[1, 0], [0]])]}, ["cam00", "4x4"]),
        (TOP | {"frames": [frame("cam00", fl_x=None)]}, ["cam00", "fl_x"]),
        (TOP | {"frames": [frame("cam00", fl_x=math.inf)]}, ["cam00", "fl_x"]),
        (TOP | {"frames": [frame("cam00", fl_x=-1)]}, ["cam00", "-1"]),
        (TOP | {"frames": [frame("cam00", w=0)]}, ["cam00", "w = 0"]),
        (TOP | {"frames": [frame("cam00", k4=0.1)]}, ["cam00", "k4"]),
        (TOP | {"frames": [frame("cam00", camera_model="THIN_PRISM_FISHEYE")]}, ["cam00", "THIN_PRISM"]),
        (TOP | {"frames": [frame("cam00"), frame("cam00")]}, ["cam00"]),
        (TOP | {"frames": [frame("../cam00")]}, ["../cam00"]),
        (TOP | {"frames": [3]}, ["frame 0"]),
        (TOP | {"frames": []}, ["frames"]),
        ({"fl_x": 45.0, "frames": [frame("cam00")]}, ["cam00", "w"]),
        (TOP, ["frames"]),
        ([], ["table"]),
    ],
)
def test_malformed_transforms_are_refused_in_one_line_that_names_the_place(tmp_path, document, words):
    path = write_json(tmp_path / "transforms.json", document)
    with pytest.raises(RigError) as refusal:
        load_cameras(path, 20000)
    message = str(refusal.value)
    assert "\n" not in message
    for word in ["transforms.json", *words]:
        assert word in message


def test_every_format_gives_the_same_rig(tmp_path):
    (tmp_path / "transforms.json").write_text(dump_transforms(LAB.cameras[::-1]))
    (tmp_path / "lab.toml").write_text(dump_rig(Rig("lab", 20000, LAB.cameras, "nominal")))
    write_model(tmp_path / "model", LAB.cameras)
    for name, poses in (("transforms.json", "calibrated"), ("model", "calibrated"), ("lab.toml", "nominal")):
        rig = load_cameras(tmp_path / name, 40000, size=(400, 250), ids=LAB.ids)
        assert_same_cameras(rig.cameras, LAB.cameras)
        assert (rig.tick_rate_hz, rig.poses, rig.name) == (40000, poses, name.split(".")[0])


def test_cameras_that_do_not_fit_the_streams_are_named(tmp_path):
    path = tmp_path / "transforms.json"
    path.write_text(dump_transforms(LAB.cameras))
    with pytest.raises(RigError, match="not expected: cam22"):
        load_cameras(path, 20000, ids=LAB.ids[:-1])
    with pytest.raises(RigError, match="missing: cam23"):
        load_cameras(path, 20000, ids=[*LAB.ids, "cam23"])
    with pytest.raises(RigError, match=r"cam00: found the size 400x250, expected 401x250"):
        load_cameras(path, 20000, size=(401, 250))
    with pytest.raises(RigError, match="tick rate 0"):
        load_cameras(path, 0)
    path.write_text(dump_transforms(LAB.cameras[:4] + LAB.cameras[5:]))
    with pytest.raises(RigError, match="expected also cam11"):
        load_cameras(path, 20000)
    path.write_text("{")
    with pytest.raises(RigError, match="JSON"):
        load_cameras(path, 20000)
    for name in ("none.json", "none", "."):
        with pytest.raises(RigError, match=str(tmp_path)):
            load_cameras(tmp_path / name, 20000)


PYCOLMAP = """
import sys, pycolmap
model = pycolmap.Reconstruction(sys.argv[1])
model.write_binary(sys.argv[2])
model.write_text(sys.argv[3])
for image in model.images.values():
    print(image.name, *image.cam_from_world().matrix().ravel(), *image.camera.calibration_matrix().ravel())
"""


def test_pycolmap_reads_our_text_and_we_read_what_it_writes(tmp_path):
    pytest.importorskip("pycolmap", exc_type=ImportError)
    folders = [write_model(tmp_path / "ours", LAB.cameras), tmp_path / "binary", tmp_path / "text"]
    for folder in folders[1:]:
        folder.mkdir()
    # In a process of its own: pycolmap and OpenCV do not load after one another in every order.
    done = subprocess.run([sys.executable, "-c", PYCOLMAP, *folders], capture_output=True, text=True, check=True)
    for line in done.stdout.splitlines():
        name, *values = line.split()
        camera = LAB.camera(name.removesuffix(".png"))
        want = [*camera.cam_from_rig.matrix[:3].ravel(), *camera.K.ravel()]
        np.testing.assert_allclose(np.array(values, dtype=float), want, atol=1e-12)
    for folder in folders:
        assert_same_cameras(load_cameras(folder, 20000).cameras, LAB.cameras)


@pytest.mark.parametrize(
    ("model", "parameters", "want"),
    [
        ("SIMPLE_PINHOLE", "9 4 3", (9, 9, 4, 3, 0, 0, 0, 0)),
        ("PINHOLE", "9 8 4 3", (9, 8, 4, 3, 0, 0, 0, 0)),
        ("SIMPLE_RADIAL", "9 4 3 .1", (9, 9, 4, 3, 0.1, 0, 0, 0)),
        ("RADIAL", "9 4 3 .1 .2", (9, 9, 4, 3, 0.1, 0.2, 0, 0)),
        ("OPENCV", "9 8 4 3 .1 .2 .3 .4", (9, 8, 4, 3, 0.1, 0.2, 0.3, 0.4)),
        ("OPENCV_FISHEYE", "9 8 4 3 .1 .2 .3 .4", (9, 8, 4, 3, 0.1, 0.2, 0.3, 0.4)),
        ("FULL_OPENCV", "9 8 4 3 .1 .2 .3 .4 .5 0 0 0", (9, 8, 4, 3, 0.1, 0.2, 0.3, 0.4, 0.5)),
    ],
)
def test_colmap_models_in_text_and_binary(tmp_path, model, parameters, want):
    numbers = [float(p) for p in parameters.split()]
    listed = "SIMPLE_PINHOLE PINHOLE SIMPLE_RADIAL RADIAL OPENCV OPENCV_FISHEYE FULL_OPENCV"  # COLMAP's models.h
    number = listed.split().index(model)
    text, binary = tmp_path / "text", tmp_path / "binary"
    for folder in (text, binary):
        folder.mkdir()
    (text / "cameras.txt").write_text(f"# a comment\n\n7 {model} 8 6 {parameters}\n")
    (text / "images.txt").write_text("# a comment\n\n2 1 0 0 0 1 2 3 7 cam01\n\n1 1 0 0 0 0 0 0 7 cam00.png\n5 5 -1\n")
    lens = struct.pack(f"<QIiQQ{len(numbers)}d", 1, 7, number, 8, 6, *numbers)
    images = struct.pack("<QI7dI6sQ", 2, 2, 1, 0, 0, 0, 1, 2, 3, 7, b"cam01", 0)
    images += struct.pack("<I7dI10sQddq", 1, 1, 0, 0, 0, 0, 0, 0, 7, b"cam00.png", 1, 5, 5, -1)
    (binary / "cameras.bin").write_bytes(lens)
    (binary / "images.bin").write_bytes(images)
    for folder in (text, binary):
        first, second = load_cameras(folder, 20000).cameras
        assert (first.id, second.id) == ("cam00", "cam01")
        assert (first.fx, first.fy, first.cx, first.cy, *first.distortion) == want
        assert first.lens_model == ("fisheye" if "FISHEYE" in model else "opencv")
        np.testing.assert_array_equal(second.cam_from_rig.translation, [1, 2, 3])
    for file in (binary / "cameras.bin", binary / "images.bin"):
        whole = file.read_bytes()
        for length in range(len(whole)):
            file.write_bytes(whole[:length])
            with pytest.raises(RigError, match=file.name):
                load_cameras(binary, 20000)
        file.write_bytes(whole)


@pytest.mark.parametrize(
    ("file", "text", "words"),
    [
        ("cameras.txt", "1 FOV 8 6 9 8 4 3 .1\n", ["cameras.txt", "FOV", "OPENCV"]),
        ("cameras.txt", "1 PINHOLE 8 6 9 8 4\n", ["cameras.txt", "3 parameters", "4"]),
        ("cameras.txt", "1 PINHOLE 8 6 9 x 4 3\n", ["cameras.txt", "'x'"]),
        ("cameras.txt", "1 PINHOLE 8\n", ["cameras.txt"]),
        ("cameras.txt", "2 PINHOLE 8 6 9 8 4 3\n", ["cam00", "no camera 1"]),
        ("cameras.txt", "1 PINHOLE 8 6 -9 8 4 3\n", ["cam00", "-9"]),
        ("images.txt", "1 1 0 0 0 nan 0 0 1 cam01.png\n\n", ["cam01", "NaN"]),
        ("images.txt", "1 0 0 0 0 0 0 0 1 cam01.png\n\n", ["cam01", "quaternion"]),
        ("images.txt", "1 1 0 0 0 0 0 0 1\n\n", ["images.txt"]),
        ("images.txt", "# none\n", ["images.txt", "no images"]),
    ],
)
def test_malformed_colmap_models_are_refused(tmp_path, file, text, words):
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 8 6 9 8 4 3\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 cam00.png\n\n")
    assert load_cameras(tmp_path, 20000).ids == ("cam00",)
    (tmp_path / file).write_text(text)
    with pytest.raises(RigError) as refusal:
        load_cameras(tmp_path, 20000)
    for word in words:
        assert word in str(refusal.value)


def test_a_colmap_model_of_more_points_than_memory_has_is_one_line(tmp_path):
    lens = struct.pack("<QIiQQ4d", 1, 1, 1, 24, 16, 20, 20, 12, 8)
    (tmp_path / "cameras.bin").write_bytes(lens)
    pose = struct.pack("<QI7dI10sQ", 1, 1, 1, 0, 0, 0, 0, 0, 0, 1, b"cam00.png", 2**62)
    (tmp_path / "images.bin").write_bytes(pose)
    with pytest.raises(RigError, match=r"images\.bin"):
        load_cameras(tmp_path, 20000)


def test_a_file_name_that_is_no_text_names_a_rig_that_can_be_written(tmp_path):
    file = tmp_path / os.fsdecode(b"bad\xff.json")
    file.write_text(dump_transforms(LAB.cameras))
    rig = load_cameras(file, 20000)
    assert rig.name == "bad\ufffd"
    dump_rig(rig).encode()
