"""The path tracer against light that is known in closed form; skipped where the extra is not installed."""

import json
from dataclasses import replace

import numpy as np
import pytest
from maintenance.realistic_digests import LONG_INSTANTS_S, setting_digest

from acquisition.devices.open import Simulation
from acquisition.scenes.bodies import about
from acquisition.scenes.catalog import REALISTIC_LONG, build_scene
from acquisition.scenes.digest import COMMITTED_REALISTIC, committed_digests
from acquisition.scenes.random.rooms import BRIGHTEST, Room
from acquisition.scenes.realistic.meshes import ball, box, sheet
from acquisition.scenes.realistic.setting import FIRST_S, KEYFRAME_S, KEYFRAMES, Finish, Lamp, Setting, Thing
from acquisition.session.record import simulate
from reconstruction.networks.training.clips import VIEW_KINDS, MultiviewClips
from rigs.toml import catalog_rig

for needed in ("mitsuba", "pybullet", "skimage"):
    pytest.importorskip(needed, reason="needs the extra `realistic`: pip install 'spike4dgs[realistic]'")
pytestmark = pytest.mark.slow

CAMERA = catalog_rig("lab3x3").scaled(40, 25).camera("cam11")
CORNERS = ((-3.0, -3.0, -1.0), (3.0, 3.0, 3.0))
WALL = sheet((0, 0, 2.5), (6, 0, 0), (0, -6, 0))
BEHIND = Lamp((0.0, 0.0, -0.5), (3.0, 0, 0), (0, 3.0, 0), 0.25)
PIXELS = np.arange(CAMERA.width * CAMERA.height, dtype=np.uint32)


def painted(things, rays=4, **light):
    from acquisition.scenes.realistic.painter import Painter, paint

    painter = Painter(Setting(tuple(things), CORNERS, **light))
    painter.stand(0.0)
    return painter, paint(painter, painter.whole, CAMERA, PIXELS, rays, 1).light.reshape(CAMERA.height, CAMERA.width)


def test_a_matt_wall_before_a_boundless_lamp_has_its_albedo_times_the_lamp():
    panel = Lamp((0.0, 0.0, -0.5), (150.0, 0, 0), (0, 150.0, 0), 0.5)
    _, light = painted([Thing("wall", WALL, Finish((0.0, 0.4)))], 40, lamps=(panel,))
    assert light.mean() == pytest.approx(0.2, rel=0.1)


def test_a_far_lamp_is_a_sun():
    sun = Lamp((0.0, 0.0, -40.0), (0.4, 0, 0), (0, 0.4, 0), 0.6 * np.pi * 42.5**2 / 0.64)
    _, light = painted([Thing("wall", WALL, Finish((0.0, 0.5)))], lamps=(sun,))
    np.testing.assert_allclose(light, 0.3, rtol=0.01)


def test_a_small_lamp_falls_off_with_the_square_of_its_distance():
    lamp = Lamp((0.0, 0.0, 1.0), (0.01, 0, 0), (0, -0.01, 0), 100.0)  # it turns its back on the wall
    turned = Lamp((0.0, 0.0, 1.0), (0.01, 0, 0), (0, 0.01, 0), 100.0)
    wall = Thing("wall", WALL, Finish((0.0, 0.5)))
    _, light = painted([wall], lamps=(turned,))
    x, y = 2.5 * (26.5 - CAMERA.cx) / CAMERA.fx, 2.5 * (2.5 - CAMERA.cy) / CAMERA.fy
    square = x**2 + y**2 + 1.5**2
    assert light[2, 26] == pytest.approx(0.5 / np.pi * 100 * 4e-4 * 1.5**2 / square**2, rel=0.03)
    assert painted([wall], lamps=(lamp,))[1][2, 26] == pytest.approx(0, abs=1e-6)


def test_a_mirror_shows_what_is_behind_the_camera():
    mirror = Thing("mirror", WALL, Finish((0.0, 0.0), mirror=0.9))
    _, light = painted([mirror], lamps=(BEHIND,), bounces=2)
    np.testing.assert_allclose(light[5:20, 8:32], 0.9 * 0.25, rtol=1e-4)


def test_depth_and_objects_are_those_of_the_centre_rays():
    from acquisition.scenes.realistic.painter import look

    poses = np.tile(np.c_[np.eye(3), (0.0, 0.0, 2.0)], (KEYFRAMES, 1, 1))
    painter, _ = painted(
        [Thing("wall", WALL, Finish((0.0, 0.4))), Thing("ball", ball(0.5), Finish((0.0, 0.4)), poses)], lamps=(BEHIND,)
    )
    depth, objects = look(painter, CAMERA)
    assert depth[0, 0] == pytest.approx(2.5, rel=1e-5)
    assert depth[12, 20] == pytest.approx(1.5, abs=0.003)
    assert (objects[0, 0], objects[12, 20]) == (1, 2)


def test_rays_of_pinholes_are_to_the_bit_what_they_were_before_there_were_lenses():
    from acquisition.scenes.realistic.rays import _number, center_rays, dr, mi

    number = dr.arange(mi.UInt32, CAMERA.width * CAMERA.height)
    x, y = mi.Float(number % CAMERA.width) + 0.5, mi.Float(number // CAMERA.width) + 0.5
    fx, fy, cx, cy = (_number(value) for value in (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy))
    seen = dr.normalize(mi.Vector3f((x - cx) / fx, (y - cy) / fy, 1))
    wanted = [dr.dot(mi.Vector3f(*map(_number, row)), seen) for row in CAMERA.cam_from_rig.rotation.T]
    ray, forward = center_rays(CAMERA)
    np.testing.assert_array_equal(np.array(ray.d), np.stack([np.array(axis) for axis in wanted]))
    np.testing.assert_array_equal(np.array(forward), np.array(seen.z))


def test_rays_through_a_lens_look_where_the_camera_says():
    from acquisition.scenes.realistic.painter import Painter, look
    from acquisition.scenes.realistic.rays import Rays, mi

    leaning = sheet((0, 0, 2.5), (6, 0, 2.0), (0, -6, 0))  # z = 2.5 + x / 3
    painter = Painter(Setting((Thing("wall", leaning, Finish((0.0, 0.4))),), CORNERS, lamps=(BEHIND,)))
    plain = catalog_rig("lab3x3").camera("cam11").scaled(200, 125)  # the rig's frame is its own
    rows, columns = np.indices((plain.height, plain.width)) + 0.5
    pixels = np.arange(0, plain.width * plain.height, 977)
    corners = np.stack(np.divmod(pixels, plain.width)[::-1], axis=1)[:, None]
    opencv = [{"distortion": numbers} for numbers in ((-0.22, 0.01, 0.002, -0.001), (0.1, 0.0, 0.0, 0.0, 0.02))]
    for lens in (*opencv, {"distortion": (-0.05, 0.01, 0.0, 0.0), "lens_model": "fisheye"}):
        camera = replace(plain, **lens)
        x, _ = camera.slopes(np.stack([columns.ravel(), rows.ravel()], axis=1)).T
        depth, _ = look(painter, camera)
        off = 1e-3 / camera.fx  # rays run straight between nodes
        np.testing.assert_allclose(depth.ravel(), 2.5 / (1 - x / 3), rtol=1e-6 + off)
        rays = np.array(Rays.through(camera, mi.UInt32(pixels), 2, 5).ray.d)
        places = camera.bent((rays[:2] / rays[2]).T * (camera.fx, camera.fy) + (camera.cx, camera.cy))
        within = (places.reshape(-1, 4, 2) - corners) * 2 - [[0, 0], [1, 0], [0, 1], [1, 1]]  # of its quarter
        assert -4e-3 < within.min() < within.max() < 1 + 4e-3
        assert within.std() == pytest.approx(12**-0.5, rel=0.1)


def test_what_no_mover_reaches_is_the_same_in_every_frame():
    from acquisition.scenes.realistic.studio import CHUNK, Studio

    poses = np.stack([np.c_[about(1, 0.1 * k), (-0.5 + 0.002 * k, 0.0, 1.6)] for k in range(KEYFRAMES)])
    lamp = Lamp((0.0, -1.4, 1.0), (0.1, 0, 0), (0, 0, -0.1), 30.0)
    things = [Thing("wall", WALL, Finish((0.0, 0.5))), Thing("box", box((0.1, 0.1, 0.1)), Finish((0.0, 0.8)), poses)]
    light = Studio(Setting(tuple(things), CORNERS, lamps=(lamp,))).draw([CAMERA], 5)[0]
    assert light.shape == (CHUNK, CAMERA.height, CAMERA.width)
    spread = np.ptp(light, axis=0)
    assert (spread[:, 26:] == 0).all()
    assert spread[:, :20].max() > 0.02


def test_a_realistic_scene_is_recorded_by_its_name(tmp_path, monkeypatch):
    monkeypatch.setenv("SPIKE4DGS_CACHE", str(tmp_path / "cache"))
    rig = catalog_rig("lab3x3").scaled(40, 25)
    simulate(Simulation("plain_room", seed=1, truth_every=4), rig, 8, tmp_path / "rec")
    said = json.loads((tmp_path / "rec/truth/scene.json").read_text())
    assert {mover["name"] for mover in said["movers"]} == {"ball", "duck"}
    light, depth = (np.load(tmp_path / f"rec/truth/cam11/{name}000004.npy") for name in ("", "depth_"))
    assert 0.1 < light.mean() < 0.4
    assert 1.2 < depth.min() < depth.max() < 3.4
    room = build_scene("plain_room", 1)
    shown = room.view(rig.camera("cam11"), 2).light(np.array([FIRST_S + 41 * KEYFRAME_S]))
    assert 0 < np.abs(shown[0] - light).mean() < 0.02 * light.mean()  # truth has more rays
    assert len(list((tmp_path / "cache").rglob("light_????.npy"))) == 9 * 2


def test_settled_light_is_the_same_light_with_less_noise(monkeypatch):
    from acquisition.scenes.realistic import settled
    from acquisition.scenes.realistic.painter import paint
    from acquisition.scenes.realistic.studio import Studio

    poses = np.stack([np.c_[about(1, 0.1 * k), (-0.5 + 0.002 * k, 0.0, 1.6)] for k in range(KEYFRAMES)])
    lamp = Lamp((0.0, -1.4, 1.0), (0.4, 0, 0), (0, 0, -0.4), 12.0)  # large: soft shadows
    things = [Thing("wall", WALL, Finish((0.0, 0.5))), Thing("box", box((0.1, 0.1, 0.1)), Finish((0.0, 0.8)), poses)]
    drawn = []
    monkeypatch.setattr(settled, "paint", lambda *given: drawn.append(len(given[3])) or paint(*given))
    studio = Studio(Setting(tuple(things), CORNERS, lamps=(lamp,)))
    light = studio.true_light(CAMERA, 0.0)
    painter = studio._painter
    many, few = (paint(painter, painter.whole, CAMERA, PIXELS, rays, 7).light.reshape(light.shape) for rays in (40, 4))
    error, noise = (np.sqrt(np.mean((image - many) ** 2)) for image in (light, few))
    assert error < min(1.5 * settled.NOISE, 0.6 * noise)
    assert min(drawn) < len(PIXELS) / 2  # what had settled was not drawn on
    again, later = studio.true_light(CAMERA, 0.0), studio.true_light(CAMERA, 0.02)
    np.testing.assert_array_equal(again, light)
    assert (later != light).any()
    np.testing.assert_array_equal(later[:, 30:], light[:, 30:])  # no mover reaches these


def test_a_tenth_of_the_view_of_a_long_scene_moves_in_four_spans_of_five_and_some_are_still():
    from acquisition.scenes.realistic.studio import Studio

    scene = build_scene(REALISTIC_LONG[0], 2)
    studio, spans, shares = Studio(scene.setting), 10, []
    for instant_s in (np.arange(0, 400 * spans, 100) + 0.5) / 20000:
        _, ids = studio.look(CAMERA, float(instant_s))
        moves = {
            thing.body
            for thing in scene.setting.things
            if (thing.vertices(instant_s) != thing.vertices(instant_s + 5e-5)).any()
        }
        shares.append(np.isin(ids, [scene.object_ids[name] for name in moves]).mean())
    by_span = np.reshape(shares, (spans, -1)).mean(axis=1)
    assert (by_span >= 0.1).mean() >= 0.8
    assert 0 < (by_span == 0).mean() <= 0.2


def test_the_realistic_evaluation_scenes_are_the_committed_ones():
    found = committed_digests(COMMITTED_REALISTIC)
    assert setting_digest(build_scene("loading_bay", 102).setting, LONG_INSTANTS_S) == found["loading_bay-102"]
    for name in ("marbles-101", "banner-103", "courtyard-102"):
        scene, seed = name.split("-")
        assert setting_digest(build_scene(scene, int(seed)).setting) == found[name]


def test_a_random_room_is_exposed_for_its_rig_and_the_same_whenever_it_is_drawn():
    middle_s = 0.004
    room, again = (Room(4, CAMERA, middle_s) for _ in range(2))
    view = room.view(CAMERA, 3)
    frames = view.frames(np.array([middle_s]))
    assert np.quantile(frames.intensity, BRIGHTEST) == pytest.approx(room.white, rel=1e-4)
    assert np.isfinite(frames.depth).mean() > 0.99
    instants_s = middle_s + KEYFRAME_S / 2 * np.arange(3)
    between = view.light(instants_s)
    assert between[1] == pytest.approx((between[0] + between[2]) / 2, abs=1e-5)
    assert np.abs(between[0] - frames.intensity[0]).mean() < 0.02 * room.white
    assert np.array_equal(between, again.view(CAMERA, 3).light(instants_s))


def test_clips_of_photographs_and_of_rooms_are_made():
    clips = MultiviewClips(first_seed=1, count=2, views=2, width=40, height=32, kinds=VIEW_KINDS)
    for seed in clips.seeds:
        clip = clips.make(seed)
        assert np.isfinite(clip.depth).mean() > 0.5
        fired = np.mean([stream.planes(0, len(stream)).mean() for stream in clip.streams])
        assert 0.1 * clip.white < fired < clip.white
