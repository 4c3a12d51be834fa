import numpy as np
import pytest

from acquisition.errors import AcquisitionError
from acquisition.scenes.random.several_views import (
    DISTANCE_M,
    LAGS,
    SPACING_M,
    multiview_scene,
    random_own,
    random_rig,
)

SEEDS = range(6)


def test_the_same_seed_is_the_same_rig_and_scene():
    a, again, b = random_rig(5, 4, 192, 128), random_rig(5, 4, 192, 128), random_rig(6, 4, 192, 128)
    assert a.ids == again.ids
    assert all(
        np.array_equal(x.cam_from_rig.matrix, y.cam_from_rig.matrix)
        for x, y in zip(a.cameras, again.cameras, strict=True)
    )
    assert a.cameras[0].fx != b.cameras[0].fx
    one, two = multiview_scene(5, 170.0), multiview_scene(5, 170.0)
    assert np.array_equal(one.arrays.shapes, two.arrays.shapes)
    assert np.array_equal(one.textures, two.textures)


@pytest.mark.parametrize("views", [3, 9])
def test_cameras_stand_apart_and_look_at_one_place(views):
    for seed in SEEDS:
        rig = random_rig(seed, views, 192, 128)
        assert len(set(rig.ids)) == views
        centers = np.array([camera.center for camera in rig.cameras])
        gaps = np.linalg.norm(centers[:, None] - centers[None], axis=-1)[~np.eye(views, dtype=bool)]
        assert gaps.min() > 0.03
        assert gaps.max() < 3 * SPACING_M[1] + 0.2
        for camera in rig.cameras:
            ahead = camera.cam_from_rig.apply([0, 0, np.mean(DISTANCE_M)])
            assert ahead[2] > 1
            assert np.abs(ahead[:2] / ahead[2] * camera.fx).max() < 60


def test_every_view_is_filled_by_the_scene():
    for seed in SEEDS:
        rig = random_rig(seed, 3, 48, 32)
        scene = multiview_scene(seed, rig.cameras[0].fx)
        for camera in rig.cameras:
            depth = scene.render(camera, np.zeros(1), 1).depth
            assert np.isfinite(depth).mean() > 0.9
            assert np.nanmin(depth) > 0.3


def test_most_scenes_stand_still_and_some_have_a_floor():
    scenes = [multiview_scene(seed, 170.0) for seed in range(16)]
    assert 0.5 < np.mean([not scene.movers for scene in scenes]) < 1
    floors = np.mean([any(body.name == "floor" for body in scene.bodies) for scene in scenes])
    assert 0.2 < floors < 0.95


def test_a_rig_of_one_or_ten_views_is_refused():
    for views in (1, 10):
        with pytest.raises(AcquisitionError, match="2 to 9"):
            random_rig(0, views, 192, 128)


def test_lenses_gains_and_lags_differ_from_camera_to_camera_and_come_again():
    rigs = [random_rig(seed, 3, 192, 128) for seed in SEEDS]
    assert len({(c.cx, c.cy) for rig in rigs for c in rig.cameras}) == 3 * len(rigs)
    middles = np.array([(c.cx - 96, c.cy - 64) for rig in rigs for c in rig.cameras])
    assert 1 < middles.std() < 8
    own = [random_own(seed, 3) for seed in SEEDS]
    assert own == [random_own(seed, 3) for seed in SEEDS]
    gains, lags = np.array(own).reshape(-1, 2).T
    assert 0.03 < gains.std() < 0.15
    assert 0.1 < np.abs(lags).max() <= LAGS
