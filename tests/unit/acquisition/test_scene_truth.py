"""`truth/` holds exactly what the recording contract names, and the light the sensor saw."""

import json

import numpy as np
import pytest

from acquisition.errors import BadRecordingError
from acquisition.scenes.catalog import build_scene
from acquisition.scenes.truth import EVERY, MOST_INSTANTS, exposures_of, novel_cameras, stride_of, write_truth
from rigs.exchange.nerfstudio import load_transforms
from rigs.toml import catalog_rig

RIG = catalog_rig("lab3x3").scaled(41, 26)
SCENE = build_scene("fan_and_ball", 2)


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording") / "truth"
    write_truth(SCENE, RIG, 50, 20, folder, samples=2, sensor="ideal")
    return folder


def test_the_folder_holds_what_the_contract_names_and_nothing_else(truth):
    planes = ("000000", "000020", "000040")
    novel = {f"novel{n}/{kind}{k}.npy" for n in (0, 1) for kind in ("", "depth_", "id_") for k in planes}
    rig = {f"{c}/{kind}{k}.npy" for c in RIG.ids for kind in ("", "depth_", "id_", "blur_") for k in planes}
    found = {str(path.relative_to(truth)) for path in truth.rglob("*") if path.is_file()}
    assert found == novel | rig | {"cameras.json", "scene.json"}


def test_arrays_are_the_scene_at_the_middle_of_the_plane(truth):
    frames = SCENE.view(RIG.camera("cam02"), 2).frames(np.array([20.5 / 20000]))
    for prefix, expected in (("", frames.intensity), ("depth_", frames.depth), ("id_", frames.ids)):
        stored = np.load(truth / "cam02" / f"{prefix}000020.npy")
        assert stored.dtype == expected.dtype
        np.testing.assert_array_equal(stored, expected[0])


def test_blur_is_the_mean_light_of_its_window(truth):
    every_plane = (20 + 0.5 + np.arange(-16, 16) + 0.5) / 20000
    mean = SCENE.view(RIG.camera("cam11"), 2).light(every_plane).mean(axis=0)
    blur = np.load(truth / "cam11" / "blur_000020.npy")
    sharp = np.load(truth / "cam11" / "000020.npy")
    assert np.sqrt(np.mean((blur - mean) ** 2)) < 0.2 * np.sqrt(np.mean((sharp - mean) ** 2))


def test_cameras_are_exact_and_novel_ones_are_nobodys(truth):
    stored = {camera.id: camera for camera in load_transforms(truth / "cameras.json")}
    assert list(stored) == [*RIG.ids, "novel0", "novel1"]
    for camera in (*RIG.cameras, *novel_cameras(SCENE, RIG)):
        assert (stored[camera.id].K == camera.K).all()
        assert np.abs(stored[camera.id].cam_from_rig.matrix - camera.cam_from_rig.matrix).max() < 1e-12
    for novel in ("novel0", "novel1"):
        assert min(np.linalg.norm(stored[novel].center - camera.center) for camera in RIG.cameras) > 0.05
        assert np.isfinite(np.load(truth / novel / "depth_000040.npy")).all()


def test_progress_goes_on_within_a_camera_and_never_back(tmp_path):
    told: list[tuple[float, str]] = []
    one = RIG.only(["cam11"])
    write_truth(SCENE, one, 50, 20, tmp_path / "truth", lambda *said: told.append(said), samples=1)
    shares = [share for share, _ in told]
    assert shares == sorted(set(shares))
    assert shares[-1] == 1.0
    within = [share for share, said in told if said == "truth of cam11"]
    assert len(within) == len(list((tmp_path / "truth/cam11").glob("*.npy")))
    assert max(within) < 1 / 3


def test_the_description_says_what_moves(truth):
    scene = json.loads((truth / "scene.json").read_text())
    assert scene["white"] == 0.6
    assert {mover["name"] for mover in scene["movers"]} == {"fan", "ball"}
    assert all(scene["object_ids"][mover["name"]] == mover["id"] for mover in scene["movers"])
    assert {key: scene[key] for key in ("scene", "seed", "ticks", "tick_rate_hz", "every", "sensor")} == {
        "scene": "fan_and_ball",
        "seed": 2,
        "ticks": 50,
        "tick_rate_hz": 20000.0,
        "every": 20,
        "sensor": "ideal",
    }
    ids = np.load(truth / "cam11" / "id_000000.npy")
    assert {mover["id"] for mover in scene["movers"]} <= set(ids.ravel().tolist()) <= set(scene["object_ids"].values())


def test_flicker_is_in_the_truth_and_the_description(tmp_path):
    scene, rig = build_scene("flicker", 1), RIG.only(["cam11"])
    write_truth(scene, rig, 101, 100, tmp_path / "truth", samples=2)
    bright, half = (np.load(tmp_path / f"truth/cam11/{plane:06d}.npy") for plane in (0, 100))
    assert half.mean() == pytest.approx(0.2 * bright.mean(), rel=0.05)  # 5 ms later, at the least light
    blur = np.load(tmp_path / "truth/cam11/blur_000100.npy")
    assert blur.mean() > 1.02 * half.mean()  # its exposure reaches into brighter light
    light = json.loads((tmp_path / "truth/scene.json").read_text())["light"]
    assert light["flicker"] == {"rate_hz": 100.0, "depth": 0.8, "phase_rad": 0.0}
    assert light["uneven"] is None


def test_the_description_says_when_what_is_not_always_there_appears(tmp_path):
    write_truth(build_scene("burst", 1), RIG.only(["cam11"]), 1, 1, tmp_path / "truth", samples=1)
    movers = json.loads((tmp_path / "truth/scene.json").read_text())["movers"]
    assert len(movers) == 8
    assert all(mover["from_s"] == 0.008 and mover["to_s"] is None for mover in movers)


def frames_of(instants: int, ticks: int = 40_000) -> list[int]:
    return [exposure.first for exposure in exposures_of(20_000, ticks, instants)]


def test_frames_of_an_ordinary_camera_are_no_more_than_the_true_instants():
    assert frames_of(20, 400) == [0, 100, 200, 300]
    assert frames_of(1) == [0]
    assert frames_of(3) == [0, 13_400, 26_800]
    assert frames_of(10_000) == list(range(0, 40_000, 200))  # no more than MOST_INSTANTS
    assert frames_of(0, 0) == []


def test_one_camera_still_gets_viewpoints_of_its_own():
    places = [camera.center for camera in novel_cameras(SCENE, RIG.only(["cam11"]))]
    assert all(np.linalg.norm(place - RIG.camera("cam11").center) > 0.05 for place in places)


def test_a_taken_folder_and_an_empty_clip_are_refused(tmp_path, truth):
    with pytest.raises(BadRecordingError, match="expected a new folder"):
        write_truth(SCENE, RIG, 50, 20, truth)
    for ticks, every in ((0, 20), (50, 0)):
        with pytest.raises(BadRecordingError, match="at least 1"):
            write_truth(SCENE, RIG, ticks, every, tmp_path / "truth")
    assert not (tmp_path / "truth").exists()


def test_truth_of_long_recordings_is_bounded():
    strides = {planes: stride_of(planes) for planes in (1, 400, 4000, 4001, 20_000, 72_000_000)}
    assert [strides[planes] for planes in (1, 400, 4000, 4001, 20_000)] == [EVERY, EVERY, EVERY, 2 * EVERY, 5 * EVERY]
    for planes, stride in strides.items():
        assert -(-planes // stride) <= MOST_INSTANTS
        assert stride % EVERY == 0
