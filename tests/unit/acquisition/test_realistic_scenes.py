"""Scenes of a path tracer: what holds without one. That one draws them is in test_realistic_drawing."""

import importlib.metadata
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition.devices.open import Simulation
from acquisition.errors import AcquisitionError, BadRecordingError
from acquisition.scenes import passing
from acquisition.scenes.catalog import (
    EVALUATION_SEEDS,
    REALISTIC,
    REALISTIC_EVALUATION,
    REALISTIC_LONG,
    REALISTIC_LONG_EVALUATION,
    SCENES,
    build_scene,
    scenes_named,
)
from acquisition.scenes.digest import COMMITTED_REALISTIC, committed_digests
from acquisition.scenes.realistic import library, scene
from acquisition.scenes.realistic.bent import node_slopes
from acquisition.scenes.realistic.cache import LightCache, cache_folder, camera_digest
from acquisition.scenes.realistic.meshes import ball, box, capsule, drum, read_obj, sheet
from acquisition.scenes.realistic.scene import DrawnScene
from acquisition.scenes.realistic.setting import FIRST_S, KEYFRAME_S, KEYFRAMES, LASTS_S, Finish, Setting, Thing
from acquisition.scenes.realistic.settled import noise_of, sums_around
from acquisition.scenes.realistic.studio import CHUNK, REACH_PX, _grown, chunks_of
from acquisition.session import record
from reconstruction.bench.conventions import seed_of
from rigs.toml import catalog_rig

RIG = catalog_rig("lab3x3").scaled(16, 10)
CAMERA = RIG.camera("cam11")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SPIKE4DGS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(scene, "versions", lambda: {"mitsuba": "0"})
    return tmp_path / "cache"


@pytest.fixture
def drawn(cache, monkeypatch):
    """A scene whose light is drawn as the number of the keyframe, and which cameras were drawn for which chunk."""
    calls = []

    def draw(of, views, chunk):
        calls.append((chunk, len(views)))
        numbers = np.arange(chunk * CHUNK, (chunk + 1) * CHUNK, dtype=np.float32)
        for view in views:
            view.keep(chunk, np.broadcast_to(numbers[:, None, None], (CHUNK, view.camera.height, view.camera.width)))

    monkeypatch.setattr(scene, "draw", draw)
    return build_scene("plain_room", 3), calls


def keyframe_s(number):
    return FIRST_S + number * KEYFRAME_S


def test_light_runs_straight_between_keyframes(drawn):
    room, _ = drawn
    places = np.array([40.0, 40.25, 47.5, 48.0, 55.75])
    light = room.view(CAMERA, 2).light(keyframe_s(places))
    np.testing.assert_allclose(light[:, 0, 0], places, rtol=1e-5)
    assert light.shape == (5, 10, 16)
    assert light.dtype == np.float32


def test_a_later_start_and_other_light_are_those_of_the_scene(drawn):
    room, _ = drawn
    light = room.since(0.002).lit(0.5).view(CAMERA, 2).light(keyframe_s(np.array([40.0])))
    np.testing.assert_allclose(light, 0.5 * 50, rtol=1e-5)
    assert room.lit(0.5).white == 0.5 * room.white


def test_what_is_drawn_is_drawn_once_and_a_stopped_one_goes_on(drawn):
    room, calls = drawn
    room.prepare(RIG.cameras[:3], 0.002)
    needed = list(chunks_of(39, 51))
    assert calls == [(chunk, 3) for chunk in needed]
    calls.clear()
    room.prepare(RIG.cameras[:4], 0.002)
    assert calls == [(chunk, 1) for chunk in needed]
    calls.clear()
    room.view(RIG.cameras[0], 2).light(np.linspace(0, 0.002, 7))
    assert calls == []


def test_progress_says_when_drawing_ends(drawn):
    room, _ = drawn
    said = []
    room.prepare(RIG.cameras[:1], 0.004, lambda share, words: said.append((share, words)))
    shares, words = zip(*said, strict=True)
    assert list(shares) == sorted(shares)
    assert words[0] == "light of plain_room, part 1 of 4"
    assert words[-1].startswith("light of plain_room, part 4 of 4, ")
    assert words[-1].endswith(" s left")


def test_a_simulation_goes_on_while_light_is_drawn_and_never_back(drawn, tmp_path, monkeypatch):
    monkeypatch.setattr(record, "write_truth", lambda *_, **__: None)

    def shares_of_light(out):
        said = []
        record.simulate(Simulation("plain_room", seed=3), RIG, 40, tmp_path / out, lambda *told: said.append(told))
        shares = [share for share, _ in said]
        assert shares == sorted(shares)
        assert shares[-1] == 1
        return [share for share, words in said if words.startswith("light of plain_room, part")]

    np.testing.assert_allclose(shares_of_light("new"), [0, 1 / 6, 2 / 6])  # thirds of the half
    assert shares_of_light("drawn_before") == []


@pytest.mark.parametrize("instant_s", [FIRST_S - KEYFRAME_S, LASTS_S + KEYFRAME_S])
def test_an_instant_outside_the_clip_is_refused(drawn, instant_s):
    room, _ = drawn
    with pytest.raises(BadRecordingError, match="for which the scene is drawn"):
        room.view(CAMERA, 2).light(np.array([instant_s]))


def test_a_missing_package_is_named_with_what_to_install(monkeypatch):
    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", missing)
    with pytest.raises(library.MissingRendererError) as caught:
        build_scene("robot_arm", 1).view(CAMERA, 2)
    assert "spike4dgs[realistic]" in str(caught.value)
    assert caught.value.exit_code == 2
    with pytest.raises(library.MissingRendererError, match="found no a_package_that_nobody_has"):
        library.needed("a_package_that_nobody_has")


def test_the_cache_lies_where_it_is_told(monkeypatch, tmp_path):
    monkeypatch.delenv("SPIKE4DGS_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "spike4dgs"
    monkeypatch.setenv("SPIKE4DGS_CACHE", str(tmp_path / "mine"))
    assert cache_folder() == tmp_path / "mine"
    kept = LightCache("a" * 64, CAMERA)
    assert not kept.has("light_0001")
    kept.write("light_0001", np.arange(6.0))
    np.testing.assert_array_equal(kept.read("light_0001"), np.arange(6.0))
    assert not LightCache("b" * 64, CAMERA).has("light_0001")
    assert not LightCache("a" * 64, RIG.camera("cam12")).has("light_0001")
    assert camera_digest(CAMERA) != camera_digest(CAMERA.scaled(17, 10))


def test_scenes_differ_in_their_digests(cache):
    found = [DrawnScene(name, seed, SCENES[name].args[0]).digest for name in REALISTIC for seed in (1, 2)]
    assert len(set(found)) == 2 * len(REALISTIC)


def test_the_code_that_moves_things_is_in_the_digest_of_long_scenes_alone(cache, monkeypatch):
    source, read = Path(passing.__file__), Path.read_bytes
    scenes = [build_scene(name, 1) for name in (REALISTIC_LONG[0], REALISTIC[0])]
    before = [one.digest for one in scenes]
    monkeypatch.setattr(Path, "read_bytes", lambda path: b"" if path == source else read(path))
    assert [replace(one).digest == digest for one, digest in zip(scenes, before, strict=True)] == [False, True]


def test_what_lenses_need_changes_no_digest_of_pinholes(cache, monkeypatch):
    """Drawings of cameras whose lenses do not bend stay valid whatever is changed in the lines of lenses."""
    room = DrawnScene("plain_room", 3, SCENES["plain_room"].args[0])
    before = room.digest, room.bent_digest
    source, read = Path(scene.__file__).with_name("rays.py"), Path.read_bytes
    lines = read(source).splitlines(keepends=True)
    assert sum(line.endswith(scene.LENS) for line in lines) == 2
    without = b"".join(line for line in lines if not line.endswith(scene.LENS))
    for changed, same in ((without, True), (without + b"# ray\n", False)):
        monkeypatch.setattr(Path, "read_bytes", lambda path, said=changed: said if path == source else read(path))
        again = replace(room)
        assert (again.digest == before[0]) is same
        assert len({again.digest, again.bent_digest, before[1]}) == 3


def test_cameras_with_other_lenses_see_other_pictures():
    bent = [replace(CAMERA, distortion=(k1, 0.0, 0.0, 0.0)) for k1 in (0.0, -0.1, -0.2)]
    fisheye = replace(CAMERA, lens_model="fisheye", distortion=(-0.1, 0.0, 0.0, 0.0))
    assert camera_digest(bent[0]) == camera_digest(CAMERA)
    assert len({camera_digest(camera) for camera in (*bent, fisheye)}) == 4


def test_a_lens_that_folds_is_refused():
    with pytest.raises(AcquisitionError, match="cam11: found a lens that folds inside the picture"):
        node_slopes(replace(CAMERA, distortion=(-3.0, 0.0, 0.0, 0.0)))
    assert node_slopes(replace(CAMERA, distortion=(-0.2, 0.0, 0.0, 0.0))).shape == (21, 33, 2)


def test_groups_stand_for_their_scenes():
    assert scenes_named("fan,realistic") == ("fan", *REALISTIC)
    assert scenes_named("realistic-evaluation") == REALISTIC_EVALUATION
    assert scenes_named("realistic-long,realistic-long-evaluation") == (*REALISTIC_LONG, *REALISTIC_LONG_EVALUATION)
    assert (len(REALISTIC), len(REALISTIC_EVALUATION)) == (3, 5)


def test_every_evaluation_scene_and_seed_is_written_down():
    named = (*REALISTIC_EVALUATION, *REALISTIC_LONG_EVALUATION)
    names = {f"{name}-{seed}" for name in named for seed in EVALUATION_SEEDS}
    found = committed_digests(COMMITTED_REALISTIC)
    assert set(found) == names
    assert len(set(found.values())) == len(names)


def test_realistic_benches_use_the_seeds_of_their_purpose():
    assert {seed_of(name) for name in (*REALISTIC, *REALISTIC_LONG)} == {2}
    assert {seed_of(name) for name in (*REALISTIC_EVALUATION, *REALISTIC_LONG_EVALUATION)} == {EVALUATION_SEEDS[0]}


def test_things_move_straight_between_keyframes():
    poses = np.tile(np.eye(3, 4), (KEYFRAMES, 1, 1))
    poses[:, 0, 3] = np.arange(KEYFRAMES)
    corner = Thing("box", box((0.1, 0.2, 0.3)), Finish((0.0, 0.5)), poses)
    still = Thing("floor", sheet((0, 0, 0), (1, 0, 0), (0, 0, 1)), Finish((0.0, 0.5)))
    moved = corner.vertices(keyframe_s(12.25)) - corner.mesh.vertices
    np.testing.assert_allclose(moved, np.broadcast_to([12.25, 0, 0], moved.shape), atol=1e-6)
    np.testing.assert_array_equal(still.vertices(0.1), still.mesh.vertices)
    setting = Setting((still, corner), ((-1, -1, -1), (1, 1, 1)), ())
    assert setting.object_ids == {"floor": 1, "box": 2}
    assert setting.movers == {"box": 2}


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (box((0.1, 0.2, 0.3)), 8 * 0.1 * 0.2 * 0.3),
        (ball(0.2), 4 / 3 * np.pi * 0.2**3),
        (drum(0.2, 0.3), np.pi * 0.2**2 * 0.6),
        (capsule(0.2, 0.3), np.pi * 0.2**2 * 0.6 + 4 / 3 * np.pi * 0.2**3),
    ],
)
def test_meshes_are_closed_and_face_outwards(mesh, volume):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    found = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert found == pytest.approx(volume, rel=0.01)
    assert len(mesh.uv) == len(mesh.vertices)


def test_a_wavefront_file_is_read_with_quads_and_its_picture(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 3/3 -1/1\n")
    mesh = read_obj(tmp_path / "a.obj")
    np.testing.assert_array_equal(mesh.vertices[mesh.faces[1]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(mesh.uv[mesh.faces[0]], [[0, 0], [1, 0], [1, 1]])


def test_a_sheet_faces_across_times_down():
    mesh = sheet((0, 0, 2), (0.5, 0, 0), (0, -0.5, 0))
    a, b, c = mesh.vertices[mesh.faces[0]]
    assert np.cross(b - a, c - a)[2] < 0  # towards a camera at the origin


def test_what_movers_change_grows_to_all_sides():
    mask = np.zeros((21, 31), dtype=bool)
    mask[10, 15] = mask[0, 0] = True
    grown = _grown(mask)
    assert grown[10 - REACH_PX : 11 + REACH_PX, 15 - REACH_PX : 16 + REACH_PX].all()
    assert grown.sum() == (2 * REACH_PX + 1) ** 2 + (REACH_PX + 1) ** 2


def test_the_noise_of_a_mean_is_told_by_its_halves():
    rng, shape = np.random.default_rng(4), (60, 80)
    light = np.linspace(0, 1, 80) * np.ones(shape)
    sd = np.where(np.arange(80) < 40, 0.01, 0.1)
    half, other = (light + rng.normal(scale=sd, size=shape) for _ in range(2))
    noise = noise_of(half, other, np.ones(shape, bool))
    for columns, expected in ((slice(0, 36), 0.01), (slice(44, 80), 0.1)):
        assert np.sqrt(np.mean(noise[:, columns] ** 2)) == pytest.approx(expected / 2**0.5, rel=0.05)
    assert (noise_of(light, light, np.ones(shape, bool)) == 0).all()
    alone = np.zeros(shape, bool)
    alone[20, 20] = True
    told = noise_of(half * alone, other * alone, alone)
    assert told[20, 20] == pytest.approx(abs(half[20, 20] - other[20, 20]) / 2)
    assert told[10, 10] == 0


@pytest.mark.parametrize("shape", [(1, 1), (2, 9), (30, 41)])
@pytest.mark.parametrize("side", [1, 5, 9])
def test_sums_around_end_at_the_border(shape, side):
    image = np.random.default_rng(5).normal(size=shape)
    reach = side // 2
    expected = [
        [image[max(0, r - reach) : r + reach + 1, max(0, c - reach) : c + reach + 1].sum() for c in range(shape[1])]
        for r in range(shape[0])
    ]
    np.testing.assert_allclose(sums_around(image, side), expected, atol=1e-12)
