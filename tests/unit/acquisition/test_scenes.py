"""The named scenes: what they promise a reconstruction, for every seed and any length; motions; simulated cameras."""

import itertools
import json

import numpy as np
import pytest

from acquisition.errors import AcquisitionError, BadRecordingError
from acquisition.scenes import textures
from acquisition.scenes.bodies import still
from acquisition.scenes.calibration import FLAT_LEVEL
from acquisition.scenes.catalog import SCENES, build_scene
from acquisition.scenes.motion import Motion
from acquisition.scenes.scene import STILL_SAMPLES, Scene
from acquisition.scenes.source import SceneSource
from acquisition.scenes.truth import write_truth
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from rigs.camera import Camera
from rigs.clock import RigClock
from rigs.toml import catalog_rig
from rigs.transform import Transform

CENTER = Camera("cam11", 400, 250, 350.0, 350.0, 200.0, 125.0, Transform.identity())
SMALL = CENTER.scaled(41, 26)


def source(camera=SMALL, ticks=70, **kind) -> SceneSource:
    sensor = Sensor(camera.width, camera.height, "real", 3, 4)
    layout = PlaneLayout(camera.width, camera.height)
    return SceneSource(build_scene("fan_and_ball", 3), camera, RigClock(20000.0), ticks, sensor, layout, **kind)


def test_planes_do_not_depend_on_how_many_are_rendered_at_a_time(monkeypatch):
    whole = source(ticks=12).next_planes(12)
    for most in (1, 5 * SMALL.width * SMALL.height):  # a plane at a time, and five
        monkeypatch.setattr("acquisition.scenes.source.CHUNK_PX", most)
        np.testing.assert_array_equal(source(ticks=12).next_planes(12), whole)


@pytest.mark.parametrize("name", ["fan_and_ball", "flicker"])
def test_what_nothing_moving_changes_is_recorded_with_the_rays_of_truth(name):
    scene, instants_s = build_scene(name, 3), np.linspace(0, 0.02, 5)
    light = scene.view(SMALL, 2).light(instants_s)
    true, coarse = (scene.render(SMALL, instants_s, samples) for samples in (STILL_SAMPLES, 2))
    gains = scene.placements(instants_s).gains.astype(np.float32)[:, None, None]
    bare, fine = (gains * scene.raycaster(SMALL, samples).still_intensity for samples in (2, STILL_SAMPLES))
    still = coarse.intensity == bare
    assert 0.5 < still.mean() < 1
    np.testing.assert_array_equal(light, np.where(still, fine, coarse.intensity))
    both = still & (true.intensity == fine)
    assert both.mean() > 0.9 * still.mean()
    assert np.abs(coarse.intensity - true.intensity)[both].max() > 0.01 * scene.white  # at edges
    frames = scene.view(SMALL, 2).frames(instants_s)
    np.testing.assert_array_equal(frames.intensity, light)
    np.testing.assert_array_equal(frames.ids, coarse.ids)


class Film:
    """Keeps the light that a source exposes."""

    def __init__(self, camera):
        self.shape, self.light = (camera.height, camera.width), []

    def expose(self, light):
        self.light.append(light)
        return (light > 1).astype(np.uint8)


def test_a_longer_tick_gathers_the_mean_light_of_its_instants():
    scene, layout = build_scene("fan_and_ball", 3), PlaneLayout(SMALL.width, SMALL.height)
    seen = {}
    for rate_hz, ticks in ((20000.0, 70), (2000.0, 7), (40000.0, 70)):
        film = Film(SMALL)
        SceneSource(scene, SMALL, RigClock(rate_hz), ticks, film, layout).next_planes(ticks)  # pyright: ignore[reportArgumentType]
        seen[rate_hz] = np.concatenate(film.light)
        assert len(seen[rate_hz]) == ticks
    np.testing.assert_allclose(seen[2000.0], seen[20000.0].reshape(7, 10, 26, 41).mean(axis=1), atol=1e-6)
    assert np.abs(seen[2000.0] - seen[20000.0][5::10]).max() > 0.01  # one instant is not the mean


def test_less_light_is_a_factor_of_all_that_is_seen():
    scene = build_scene("fan_and_ball", 3)
    full, tenth = (s.render(SMALL, np.array([0.01]), 1).intensity for s in (scene, scene.lit(0.1)))
    np.testing.assert_allclose(tenth, 0.1 * full, rtol=1e-5)
    assert scene.lit(0.1).white == pytest.approx(0.06)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_the_demo_scene_is_worth_reconstructing(seed):
    scene = build_scene("fan_and_ball", seed)
    frames = scene.render(CENTER, np.array([0.0, 0.01, 0.02, 0.5]), 2)
    assert np.isfinite(frames.depth).all()
    assert 1.0 < frames.depth.min() < 1.5
    assert frames.depth.max() == pytest.approx(3.2)
    moving = np.isin(frames.ids, list(scene.movers.values())).mean(axis=(1, 2))
    assert (moving > 0.1).all()
    assert (moving < 0.2).all()
    for number in scene.object_ids.values():
        seen = frames.intensity[0][frames.ids[0] == number]
        assert seen.size > 500
        assert seen.std() > 0.1 * seen.mean()
    assert frames.intensity.max() <= scene.white


def test_every_camera_of_the_demo_rig_sees_surfaces_and_both_movers_everywhere():
    scene, rig = build_scene("fan_and_ball", 0), catalog_rig("lab3x3").scaled(100, 64)
    for camera in rig.cameras:
        frames = scene.render(camera, np.array([0.0, 0.019]), 1)
        assert np.isfinite(frames.depth).all()
        for number in scene.movers.values():
            assert (frames.ids == number).mean() > 0.01


def test_neighbouring_pixels_differ_on_every_part_of_the_picture():
    light = build_scene("fan_and_ball", 0).render(CENTER, np.zeros(1), 2).intensity[0]
    tiles = light[:240].reshape(12, 20, 20, 20).transpose(0, 2, 1, 3).reshape(-1, 400)
    assert (tiles.std(axis=1) > 0.06 * tiles.mean(axis=1)).mean() > 0.97
    assert (tiles.std(axis=1) > 0).all()


def test_seeds_give_other_scenes_and_the_same_seed_the_same():
    a, b, c = (build_scene("fan_and_ball", seed).render(SMALL, np.zeros(1), 2).intensity for seed in (4, 4, 5))
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - c).mean() > 0.02


def test_movers_move_fast_and_slowly():
    scene = build_scene("fan_and_ball", 0)
    assert set(scene.movers) == {"fan", "ball"}
    places = scene.placements(np.array([0.0, 1e-4])).positions
    speeds = dict(zip(scene.arrays.ids, np.linalg.norm(places[1] - places[0], axis=-1) / 1e-4, strict=True))
    assert speeds[scene.movers["ball"]] == pytest.approx(1.2, rel=0.01)
    fastest = max(np.linalg.norm(places[1] - places[0], axis=-1) / 1e-4)
    assert fastest == pytest.approx(40 * 0.205, rel=0.01)  # blade centres
    assert not any(speed for number, speed in speeds.items() if number not in scene.movers.values())


def test_the_ball_bounces_for_ever_above_its_plinth():
    scene = build_scene("fan_and_ball", 0)
    heights = scene.placements(np.linspace(0, 60, 5000))[1][:, -1, 1]
    assert heights.max() <= 0.62 - 0.36 - 0.13 + 1e-12
    assert heights.min() == pytest.approx(0.13 - 1.6**2 / 2 / 9.81, abs=1e-4)


def test_a_spin_turns_about_its_axis_and_free_flight_is_a_parabola():
    start = Transform.from_quat_wxyz((1, 2, 3, 4), (1.0, 2.0, 3.0))
    motion = Motion(start, (0, 0, 2), np.pi, (1.0, 0.0, 0.0), (0.0, 9.81, 0.0), launch_s=0.5)
    rotations, translations = motion.world_from_body(np.array([0.0, 0.5, 1.5]))
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(rotations[0], start.rotation, atol=1e-15)
    np.testing.assert_allclose(rotations[1], turn @ start.rotation, atol=1e-15)
    np.testing.assert_allclose(translations[1:], [[1, 2, 3], [2, 2 + 9.81 / 2, 3]], atol=1e-15)


def test_impossible_motions_and_scenes_are_refused():
    with pytest.raises(AcquisitionError, match="axis"):
        Motion(Transform.identity(), spin_axis=(0, 0, 0))
    with pytest.raises(AcquisitionError, match="bounce"):
        Motion(Transform.identity(), bounce_s=0)
    twins = (still("a", (0, 0, 1)), still("a", (0, 0, 2)))
    with pytest.raises(AcquisitionError, match="different names"):
        Scene("test", 0, twins, np.zeros((1, 4, 4), np.float32), (0, 0, 1), (0, 0, -1))


def test_an_unknown_scene_lists_the_known_ones():
    with pytest.raises(BadRecordingError, match=f"expected one of {', '.join(SCENES)}"):
        build_scene("volcano", 0)
    with pytest.raises(BadRecordingError, match="seed -1"):
        build_scene("fan_and_ball", -1)


def test_textures_are_in_range_strong_and_without_seams():
    for image in textures.build(np.random.default_rng(0)):
        assert image.min() >= 0
        assert image.max() <= 1
        assert image.std() > 0.12
        steepest_inside = np.abs(np.diff(image, axis=1)).mean(axis=0).max()
        assert np.abs(image[:, 0] - image[:, -1]).mean() < 1.1 * steepest_inside


def test_noise_has_a_falling_spectrum_and_a_finest_period():
    spectrum = np.abs(np.fft.fft2(textures.noise(np.random.default_rng(0)) - 0.5)) ** 2
    radius = np.hypot(*np.meshgrid(*(np.fft.fftfreq(textures.SIZE),) * 2)) * textures.SIZE
    power = [spectrum[(radius >= r) & (radius < 1.5 * r)].mean() for r in (6, 12, 24, 48)]
    assert all(later < earlier for earlier, later in itertools.pairwise(power))
    assert spectrum[radius > textures.SIZE / textures.FINEST_PERIOD].sum() < 0.02 * spectrum.sum()


@pytest.mark.parametrize("cuts", [(70,), (1, 2, 67), (33, 33, 33), (100,)])
def test_a_source_gives_the_same_planes_however_they_are_asked_for(cuts):
    reader = source()
    planes = np.concatenate([reader.next_planes(count) for count in cuts])
    whole = source(threads=2)
    np.testing.assert_array_equal(planes, whole.next_planes(70)[: sum(cuts)])
    assert len(reader.next_planes(5)) == 0


def test_a_source_is_scene_then_sensor_at_the_middle_of_each_tick():
    instants = (np.arange(40) + 0.5) / 20000
    light = build_scene("fan_and_ball", 3).view(SMALL, 2).light(instants)
    expected = pack(Sensor(41, 26, "real", 3, 4).expose(light), PlaneLayout(41, 26))
    np.testing.assert_array_equal(source().next_planes(40), expected)


def test_a_source_whose_sizes_differ_is_refused():
    with pytest.raises(BadRecordingError, match="cam11"):
        SceneSource(
            build_scene("fan_and_ball", 0), SMALL, RigClock(1.0), 1, Sensor(9, 9, "ideal", 0, 0), PlaneLayout(41, 26)
        )


@pytest.mark.parametrize(("name", "level"), [("flat", FLAT_LEVEL), ("dark", 0.0)])
def test_calibration_scenes_are_even_for_every_camera(name, level, tmp_path):
    rig = catalog_rig("lab3x3").scaled(40, 25)
    for camera in rig.cameras:
        frames = build_scene(name, 0).render(camera, np.array([0.0, 1.0]), 2)
        np.testing.assert_allclose(frames.intensity, level, rtol=1e-6)
        assert np.isfinite(frames.depth).all()
    write_truth(build_scene(name, 0), rig, 40, 20, tmp_path / "truth", samples=1)
    np.testing.assert_allclose(np.load(tmp_path / "truth/novel1/000020.npy"), level, rtol=1e-6)
    assert json.loads((tmp_path / "truth/scene.json").read_text())["white"] == FLAT_LEVEL
