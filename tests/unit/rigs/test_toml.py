from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigs.camera import Camera
from rigs.errors import RigError
from rigs.rig import Calibration, Rig
from rigs.toml import catalog_names, catalog_rig, dump_rig, load_rig
from rigs.transform import Transform

numbers = st.floats(-1e3, 1e3)
lengths = st.floats(1e-3, 1e5)
quats = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: sum(x * x for x in q) > 1e-3)
poses = st.builds(Transform.from_quat_wxyz, quats, st.tuples(numbers, numbers, numbers))
fours = st.tuples(numbers, numbers, numbers, numbers)
fives = st.tuples(numbers, numbers, numbers, numbers, numbers.filter(bool))
lenses = st.fixed_dictionaries({"distortion": fours | fives}) | st.fixed_dictionaries(
    {"distortion": fours, "lens_model": st.just("fisheye")}
)


@st.composite
def rigs(draw) -> Rig:
    rows, columns = draw(st.integers(1, 3)), draw(st.integers(1, 3))
    cameras = tuple(
        Camera(
            f"cam{row}{column}",
            draw(st.integers(1, 5000)),
            draw(st.integers(1, 5000)),
            *(draw(lengths), draw(lengths), draw(numbers), draw(numbers)),
            draw(poses),
            **draw(lenses),
            serial=draw(st.text(max_size=8)),
        )
        for row in range(rows)
        for column in range(columns)
    )
    calibration = draw(st.none() | st.builds(Calibration, st.dates().map(str), numbers, numbers))
    return Rig(draw(st.text()), draw(lengths), cameras, draw(st.sampled_from(["calibrated", "nominal"])), calibration)


def load_text(tmp_path_factory, text: str) -> Rig:
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    path.write_text(text, encoding="utf-8", newline="")
    return load_rig(path)


@given(rig=rigs())
def test_round_trip_keeps_every_number(tmp_path_factory, rig):
    back = load_text(tmp_path_factory, dump_rig(rig))
    assert (back.name, back.tick_rate_hz, back.poses, back.calibration) == (
        (rig.name, rig.tick_rate_hz, rig.poses, rig.calibration)
    )
    for a, b in zip(back.cameras, rig.cameras, strict=True):
        pose_a, pose_b = a.cam_from_rig, b.cam_from_rig
        np.testing.assert_allclose(pose_a.rotation, pose_b.rotation, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(pose_a.translation, pose_b.translation)
        a, b = (replace(c, cam_from_rig=pose_a) for c in (a, b))
        assert vars(a) == vars(b)


@pytest.mark.parametrize(("name", "width", "height", "focal"), [("lab3x3", 400, 250, 350), ("ci3x3", 100, 64, 87.5)])
def test_catalog_rig_is_the_square_it_says(name, width, height, focal):
    rig = catalog_rig(name)
    assert (rig.name, rig.tick_rate_hz, rig.poses) == (name, 20000, "calibrated")
    for camera, (row, column) in zip(rig.cameras, np.ndindex(3, 3), strict=True):
        assert (camera.id, camera.serial) == (f"cam{row}{column}", f"S4D-{row}{column}")
        assert (camera.width, camera.height, camera.fx, camera.fy) == (width, height, focal, focal)
        assert (camera.cx, camera.cy) == (width / 2, height / 2)
        want = Transform.looking_at((0.2 * (column - 1), 0.2 * (row - 1), 0), (0, 0, 1.8))
        np.testing.assert_allclose(camera.cam_from_rig.matrix, want.matrix, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(rig.camera("cam11").cam_from_rig.matrix, np.eye(4))


def test_catalog_lists_its_names_in_the_refusal():
    assert catalog_names() == ("ci3x3", "lab3x3")
    with pytest.raises(RigError, match=r"attic.*ci3x3, lab3x3"):
        catalog_rig("attic")


GOOD = dump_rig(catalog_rig("lab3x3"))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "lab3x3"\n', "", ["name"]),
        ('poses = "calibrated"', "", ["poses"]),
        ('poses = "calibrated"', 'poses = "guessed"', ["guessed", "nominal"]),
        ("tick_rate_hz = 20000.0", "tick_rate_hz = 0", ["tick rate 0"]),
        ("tick_rate_hz = 20000.0", 'tick_rate_hz = "fast"', ["tick_rate_hz", "fast"]),
        ("tick_rate_hz = 20000.0", "tick_rate = 20000.0\ntick_rate_hz = 20000.0", ["'tick_rate'"]),
        ('id = "cam00"', "", ["camera 0", "id"]),
        ('id = "cam00"', 'id = "cam01"', ["cam01"]),
        ('id = "cam00"', 'id = "cam99"', ["cam00"]),
        ("width = 400", "width = 400.5", ["cam00", "width", "400.5"]),
        ("width = 400", "width = true", ["cam00", "width", "True"]),
        ("height = 250", "height = -250", ["cam00", "height"]),
        ("fx = 350.0", "fx = nan", ["cam00", "fx", "nan"]),
        ("fx = 350.0", "fx = -350.0", ["cam00", "-350"]),
        ("fx = 350.0", "focal = 350.0", ["cam00", "'focal'"]),
        ('serial = "S4D-00"', "serial = 0", ["cam00", "serial"]),
        ("distortion = [\n    0.0,", "distortion = [", ["cam00", "distortion", "4 numbers"]),
        ("quat_wxyz = [\n    0.99", "quat_wxyz = [\n    inf, 0.99", ["cam00", "quat_wxyz"]),
        ("translation_m", "translation_mm", ["cam00", "cam_from_rig", "translation_mm"]),
        ("[camera.cam_from_rig]", "[camera.rig_from_cam]", ["cam00", "rig_from_cam"]),
        ('name = "lab3x3"', "name = lab3x3", ["TOML", "line 1"]),
    ],
)
def test_a_malformed_rig_is_refused_in_one_line_that_names_the_place(tmp_path, old, new, words):
    assert old in GOOD
    path = tmp_path / "bad.toml"
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(RigError) as refusal:
        load_rig(path)
    message = str(refusal.value)
    assert "\n" not in message
    for word in ["bad.toml", *words]:
        assert word in message


def test_a_zero_quaternion_is_refused_naming_the_camera(tmp_path):
    path = tmp_path / "bad.toml"
    start, end = GOOD.index("quat_wxyz"), GOOD.index("translation_m")
    path.write_text(GOOD[:start] + "quat_wxyz = [0, 0, 0, 0]\n" + GOOD[end:])
    with pytest.raises(RigError, match=r"bad\.toml: cam00: cam_from_rig: .*quaternion"):
        load_rig(path)


@pytest.mark.parametrize("missing", catalog_rig("lab3x3").ids)
def test_a_hole_in_the_grid_is_named(tmp_path, missing):
    rig = catalog_rig("lab3x3")
    path = tmp_path / "hole.toml"
    path.write_text(dump_rig(rig.only(c for c in rig.ids if c != missing)))
    with pytest.raises(RigError, match=f"hole.toml.*8 cameras of a 3x3 grid.*{missing}"):
        load_rig(path)


def test_files_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(RigError, match=r"none\.toml"):
        load_rig(tmp_path / "none.toml")
    with pytest.raises(RigError, match="cannot be read"):
        load_rig(tmp_path)
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RigError, match="UTF-8"):
        load_rig(tmp_path / "b.toml")


@pytest.mark.parametrize(
    ("line", "word"),
    [('date = "yesterday"', "yesterday"), ("residual_px = nan", "residual_px"), ("sigma = 1", "sigma")],
)
def test_a_malformed_calibration_is_refused(tmp_path, line, word):
    good = {"date": 'date = "2025-03-09"', "residual_px": "residual_px = 0.1", "rotation_sd_deg": "rotation_sd_deg = 1"}
    lines = "\n".join((good | {line.split()[0]: line}).values())
    path = tmp_path / "bad.toml"
    path.write_text(GOOD.replace("[[camera]]", f"[calibration]\n{lines}\n\n[[camera]]", 1))
    with pytest.raises(RigError, match=f"calibration.*{word}"):
        load_rig(path)


def test_the_rig_file_in_the_readme_loads(tmp_path):
    readme = (Path(__file__).resolve().parents[3] / "rigs/README.md").read_text()
    path = tmp_path / "bench.toml"
    path.write_text(readme.split("```toml\n")[1].split("```")[0])
    assert load_rig(path).ids == ("cam00",)


def test_pixel_calibrations_are_files_beside_the_rig(tmp_path):
    rig = catalog_rig("lab3x3").only(["cam00"])
    (tmp_path / "maps.npz").write_bytes(b"maps")
    measured = replace(rig.camera("cam00"), pixels=tmp_path / "maps.npz")
    path = tmp_path / "a.toml"
    path.write_text(dump_rig(replace(rig, cameras=(measured,))))
    assert 'pixels = "maps.npz"' in path.read_text()
    loaded = load_rig(path)
    assert loaded.cameras[0].pixels == tmp_path / "maps.npz"
    assert loaded.scaled(40, 25).cameras[0].pixels is None
    assert loaded.scaled(400, 250).cameras[0].pixels == tmp_path / "maps.npz"
    for name in ("other.npz", "../maps.npz", "/etc/passwd", "."):
        path.write_text(dump_rig(rig).replace('serial = "S4D-00"', f'pixels = "{name}"'))
        with pytest.raises(RigError, match=r"a\.toml: cam00: found pixels = .*beside the rig file"):
            load_rig(path)
