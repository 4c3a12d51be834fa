"""Cameras from rendered scenes: right, or refused by name."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition.scenes import natural
from acquisition.scenes.bodies import Body, Finish, Shape, still
from acquisition.scenes.misplaced import misplaced
from acquisition.scenes.motion import Motion
from acquisition.scenes.scene import Scene
from reconstruction.calibration.calibrated import displacement
from reconstruction.calibration.check import check_rig
from reconstruction.calibration.features import find_features, repaired
from reconstruction.calibration.matches import Gate, Tracks, gated, joined, matched
from reconstruction.calibration.moments import Moment
from reconstruction.calibration.natural import calibrate_natural, spread, triangulated
from reconstruction.calibration.patches import refined
from reconstruction.calibration.projection import Cameras, project
from reconstruction.errors import GeometryError
from reconstruction.metrics.poses import pose_errors
from rigs.rig import object_distance_m
from rigs.similarity import align
from rigs.toml import catalog_rig
from rigs.transform import Transform

RIG = misplaced(catalog_rig("lab3x3"), 1.5, 77)
FIVE = ("cam00", "cam02", "cam11", "cam20", "cam22")
DATE = "2026-11-21"
PERIOD = 64  # texels of the pattern that repeats


def textures():
    rng = np.random.default_rng(3)
    leaves = natural.leaves(rng)
    tile = np.tile(leaves[:PERIOD, :PERIOD], (natural.SIZE // PERIOD,) * 2)
    return np.stack([leaves, tile, np.full_like(leaves, 0.5)])


def wall(picture):
    face = Finish(picture, 0.005, (0.05, 1.0), (17.0, 31.0))
    pose = Transform(np.eye(3), np.array([0, 0, 3.0]))
    return Body("wall", (Shape("rectangle", (6.0, 6.0), face),), Motion(pose))


def blocks(rng):
    return [
        still(
            f"block{i}",
            tuple(rng.uniform((-0.7, -0.4, 1.5), (0.7, 0.4, 2.4))),
            Shape(
                "box",
                tuple(rng.uniform(0.1, 0.2, 3)),
                Finish(0, 0.004, (0.05, 1.0), tuple(rng.uniform(0, natural.SIZE, 2))),
            ),
        )
        for i in range(5)
    ]


def pictures(*bodies, noise=0.004, views=RIG.ids):
    rng = np.random.default_rng(5)
    scene = Scene("test", 0, bodies, textures(), (0, 0, 1.9), to_sun=(-0.36, -0.42, -0.83), mipmapped=True)
    found = {}
    for camera in RIG.only(views).cameras:
        light = scene.render(camera, np.array([0.0]), 2).intensity[0]
        found[camera.id] = np.maximum(light + noise * rng.normal(size=light.shape), 0).astype(np.float32)
    return found


@pytest.fixture(scope="module")
def room():
    return pictures(wall(0), *blocks(np.random.default_rng(9)))


def errors_of(found, images):
    return pose_errors(found.rig.only(images), RIG.only(images), object_distance_m(RIG.cameras))


@pytest.mark.parametrize(("error", "seed"), [(2, 0), pytest.param(5, 2, marks=pytest.mark.slow)])
def test_an_ordinary_scene_gives_the_cameras(room, error, seed):
    found = calibrate_natural(misplaced(RIG, error, seed), room, DATE, movers=lambda: pytest.fail("not needed"))
    off = errors_of(found, room)
    assert found.report["moving_tracks"] == 0
    assert off.rotation_deg < 0.01
    assert off.translation_percent < 0.01
    assert off.focal_percent < 0.15
    assert found.rig.poses == "calibrated"
    said = np.sqrt(np.mean([sd.rotation_deg**2 for sd in found.sd.values()]))
    real = np.sqrt(np.mean(np.degrees(np.linalg.norm(off.turns_rad, axis=1)) ** 2))
    assert 0.5 < real / said < 2


@pytest.mark.slow
def test_a_flat_wall_is_enough():
    images = pictures(wall(0))
    assert errors_of(calibrate_natural(misplaced(RIG, 2, 1), images, DATE), images).rotation_deg < 0.01


def test_few_views_are_enough_and_the_others_keep_their_place(room):
    nominal = misplaced(RIG, 2, 3)
    few = {c: room[c] for c in ("cam00", "cam01", "cam10", "cam11")}
    found = calibrate_natural(nominal, few, DATE)
    assert errors_of(found, few).rotation_deg < 0.02
    assert found.rig.camera("cam22") is nominal.camera("cam22")


def test_a_pattern_that_repeats_is_refused():
    with pytest.raises(GeometryError, match=r"tracks|contradict|off its place"):
        calibrate_natural(misplaced(RIG, 2, 1), pictures(wall(1)), DATE)


@pytest.mark.slow
def test_exchanged_views_are_named(room):
    swapped = {**room, "cam01": room["cam12"], "cam12": room["cam01"]}
    with pytest.raises(GeometryError, match="found cam01 and cam12 in each other's place"):
        calibrate_natural(misplaced(RIG, 2, 1), swapped, DATE)


@pytest.mark.slow
def test_a_moved_camera_is_named(room):
    nominal = misplaced(RIG, 1, 1)
    moved = tuple(
        replace(c, cam_from_rig=Transform(c.cam_from_rig.rotation, c.cam_from_rig.translation + np.array([0.15, 0, 0])))
        if c.id == "cam20"
        else c
        for c in nominal.cameras
    )
    with pytest.raises(GeometryError, match="cam20"):
        calibrate_natural(replace(nominal, cameras=moved), room, DATE)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda image: np.zeros_like(image), "no light in cam12"),
        (lambda image: np.full_like(image, 0.3), "cam12"),
        (lambda image: image[:, ::-1].copy(), "cam12"),
    ],
)
def test_a_view_that_sees_nothing_is_named(room, change, said):
    with pytest.raises(GeometryError, match=said):
        calibrate_natural(misplaced(RIG, 2, 1), {**room, "cam12": change(room["cam12"])}, DATE)


def test_too_little_is_refused(room):
    nominal = misplaced(RIG, 2, 1)
    with pytest.raises(GeometryError, match="2 views, expected 3"):
        calibrate_natural(nominal, {c: room[c] for c in ("cam00", "cam01")}, DATE)
    with pytest.raises(GeometryError, match="0 tracks"):
        calibrate_natural(nominal, {c: np.full_like(room[c], 0.4) for c in RIG.ids}, DATE)


def test_the_same_seed_gives_the_same_cameras(room):
    few = {c: room[c] for c in ("cam00", "cam01", "cam10")}
    one, other = (calibrate_natural(misplaced(RIG, 1, 1), few, DATE).rig.camera("cam01") for _ in range(2))
    np.testing.assert_array_equal(one.cam_from_rig.matrix, other.cam_from_rig.matrix)


def test_odd_pixels_are_repaired_and_edges_are_not():
    image = np.full((20, 30), 0.3, np.float32)
    image[:, 15:] = 0.9
    spoilt = image.copy()
    spoilt[5, 5], spoilt[9, 20] = 1.0, 0.0
    np.testing.assert_array_equal(repaired(spoilt), image)


def test_features_stand_on_pixel_centres():
    y, x = np.mgrid[:64, :64] + 0.5
    blob = np.exp(-((x - 30.5) ** 2 + (y - 41.0) ** 2) / 18).astype(np.float32)
    places = find_features(0.1 + 0.5 * blob).places
    assert np.linalg.norm(places - (30.5, 41.0), axis=1).min() < 0.1


def test_no_features_match_nothing():
    empty = find_features(np.zeros((32, 32), np.float32))
    assert len(empty) == 0
    assert matched(empty, empty).shape == (0, 2)
    assert len(joined([empty, empty], {(0, 1): matched(empty, empty)}, 2)) == 0


def test_the_gate_lets_true_matches_through_and_far_ones_not():
    rng, (one, other) = np.random.default_rng(0), RIG.cameras[3:5]
    points = rng.uniform((-0.5, -0.3, 1.5), (0.5, 0.3, 3), (50, 3))
    cameras = Cameras.of((one, other))
    places = [project(points, cameras, np.full(50, i)).pixels for i in range(2)]
    assert gated((places[0], places[1]), (one, other), Gate(1.0), 1.9).all()
    assert gated((places[0], places[1] + (0, 40)), (one, other), Gate(45.0), 1.9).all()
    assert not gated((places[0], places[1] + (0, 60)), (one, other), Gate(45.0), 1.9).any()
    behind = places[1] + np.sign(places[1][:, :1] - places[0][:, :1]) * (200, 0)
    assert gated((places[0], behind), (one, other), Gate(45.0), 1.9).mean() < 0.5


def test_patches_find_the_place_that_was_blurred_by_a_tenth():
    rng = np.random.default_rng(1)
    images = list(pictures(wall(0), noise=0.002).values())[:3]
    cameras = Cameras.of(RIG.cameras[:3])
    points = np.stack([rng.uniform(-0.4, 0.4, 200), rng.uniform(-0.3, 0.3, 200), np.full(200, 3.0)], axis=1)
    places = np.stack([project(points, cameras, np.full(200, i)).pixels for i in range(3)], axis=1)
    rough = places.copy()
    rough[:, (0, 2)] += rng.normal(0, 0.4, (200, 2, 2))
    found = refined(Tracks(rough), images).places
    good = np.isfinite(found).all(axis=(1, 2))
    assert good.mean() > 0.5
    off = np.linalg.norm(found - places, axis=2)[good][:, (0, 2)]
    assert np.median(off) < 0.06  # .55 before
    np.testing.assert_allclose(
        np.median(np.linalg.norm(triangulated(cameras, Tracks(found[good])) - points[good], axis=1)), 0, atol=0.01
    )


def test_tracks_are_thinned_evenly():
    rng = np.random.default_rng(2)
    crowd = np.concatenate([rng.uniform((0, 0), (40, 40), (900, 2)), rng.uniform((0, 0), (400, 250), (300, 2))])
    places = np.repeat(crowd[:, None], 3, axis=1)
    thin = spread(Tracks(places), RIG.cameras[:3], 300, 0)
    assert len(thin) == 300
    assert ((thin.places[:, 0] < 40).all(axis=1)).mean() < 0.3


def turned(rig, camera_id, degrees):
    turn = Transform.from_rotvec(np.radians((0, degrees, 0)))
    return replace(
        rig,
        cameras=tuple(replace(c, cam_from_rig=turn @ c.cam_from_rig) if c.id == camera_id else c for c in rig.cameras),
    )


def test_a_calibration_that_fits_is_said_to_fit(room):
    _, checks = check_rig(replace(RIG, poses="calibrated"), room, DATE)
    assert [c.camera for c in checks] == list(RIG.ids)
    assert all(c.fits for c in checks)


@pytest.mark.slow
def test_a_camera_that_was_knocked_is_named(room):
    _, checks = check_rig(turned(RIG, "cam02", 0.3), room, DATE)
    assert [c.camera for c in checks if not c.fits] == ["cam02"]
    (knocked,) = (c for c in checks if not c.fits)
    assert knocked.turn_deg == pytest.approx(0.3, abs=0.02)


@pytest.mark.slow
def test_of_a_rig_that_is_a_drawing_every_camera_is_compared_after_alignment_on_all(room):
    drawn = misplaced(RIG, 2, 7)
    _, checks = check_rig(drawn, room, DATE)
    aligned = align(RIG, drawn).carry_rig(RIG)
    assert not any(c.fits for c in checks)
    for check in checks:
        true = displacement(aligned.camera(check.camera), drawn.camera(check.camera))
        assert check.turn_deg == pytest.approx(true.turn_deg, abs=0.02)
        assert check.shift_m == pytest.approx(true.shift_m, abs=1e-3)


@pytest.fixture(scope="module")
def passing():
    """Return a plain wall with a small poster, and moments of textured balls that pass before it."""
    poster = Shape("rectangle", (0.2, 0.2), Finish(0, 0.005, (0.05, 1.0)))
    still_part = [wall(2), still("poster", (0.5, -0.2, 2.9), poster)]
    balls = []
    for moment in range(6):
        balls.append(
            [
                still(
                    f"ball{i}",
                    (x + 0.06 * moment, y, 1.5 + 0.12 * moment),
                    Shape("sphere", (0.17,), Finish(0, 0.004, (0.05, 1.0), (30.0 * i, 9.0 * moment))),
                )
                for i, (x, y) in enumerate(((-0.5, -0.2), (0.0, 0.2), (0.3, -0.25)))
            ]
        )
    background = pictures(*still_part, views=FIVE)
    moments = []
    for thrown in balls:
        seen = pictures(*still_part, *thrown, views=FIVE)
        moments.append(Moment(seen, {c: np.abs(seen[c] - background[c]) > 0.03 for c in seen}))
    return background, moments


def test_movers_are_a_wand_where_walls_are_plain(passing):
    background, moments = passing
    nominal = misplaced(RIG, 2, 1)
    with pytest.raises(GeometryError, match="move something textured through the scene"):
        calibrate_natural(nominal, background, DATE)
    found = calibrate_natural(nominal, background, DATE, movers=lambda: moments)
    off = errors_of(found, background)
    assert off.rotation_deg < 0.05
    assert off.translation_percent < 0.1
    assert int(str(found.report["moving_tracks"])) > 200
