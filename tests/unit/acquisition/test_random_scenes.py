import numpy as np
import pytest

from acquisition.errors import AcquisitionError
from acquisition.scenes.random.clutter import BRIGHT, DIM, SPEED_M_S, random_camera, random_scene

SEEDS = range(14)


@pytest.fixture(scope="module")
def scenes():
    return [random_scene(seed) for seed in SEEDS]


def test_the_same_seed_is_the_same_scene_and_another_is_not():
    a, again, b = random_scene(5), random_scene(5), random_scene(6)
    assert np.array_equal(a.arrays.shapes, again.arrays.shapes)
    assert np.array_equal(a.textures, again.textures)
    assert a.arrays.shapes.shape != b.arrays.shapes.shape or not np.array_equal(a.arrays.shapes, b.arrays.shapes)


def test_light_goes_from_dim_to_bright(scenes):
    white = np.array([scene.white for scene in scenes])
    assert (white >= DIM[0]).all()
    assert (white <= BRIGHT[1]).all()
    assert white.min() < 0.1
    assert white.max() > 0.8
    assert 0.05 < (white < DIM[1]).mean() < 0.4


def test_some_scenes_are_still_and_the_others_range_from_slow_to_fast(scenes):
    assert 0.05 < np.mean([not scene.movers for scene in scenes]) < 0.45
    speeds = [
        np.linalg.norm(body.motion.velocity_m_s)
        for scene in scenes
        for body in scene.bodies
        if any(body.motion.velocity_m_s)
    ]
    assert min(speeds) < 1
    assert 10 < max(speeds) <= SPEED_M_S[1] + 1e-9


def test_every_kind_of_shape_occurs(scenes):
    assert {shape.kind for scene in scenes for body in scene.bodies for shape in body.shapes} == {
        "box",
        "sphere",
        "cylinder",
        "rectangle",
    }


def test_all_bodies_are_in_view_at_the_middle_instant():
    middle_s = 0.004
    for seed in range(3):
        bodies = [body for body in random_scene(seed, middle_s, 96).bodies if body.name != "wall"]
        assert len(bodies) >= 3
        for body in bodies:
            _, place = body.motion.world_from_body(np.array([middle_s]))
            assert (np.abs(place[0, :2] / place[0, 2] * 350) <= 48 + 1e-6).all()


def test_textures_have_detail_up_to_the_pixel(scenes):
    """Some of the images have more than a tenth of their power in the upper half of the frequencies."""
    shares = []
    for scene in scenes[:4]:
        image = scene.render(random_camera(64, 64), np.zeros(1)).intensity[0]
        power = np.abs(np.fft.fft2((image - image.mean()) * np.outer(np.hanning(64), np.hanning(64)))) ** 2
        frequency = np.hypot(np.fft.fftfreq(64)[:, None], np.fft.fftfreq(64)[None])
        shares.append(power[frequency > 0.25].sum() / power.sum())
    assert max(shares) > 0.1


@pytest.mark.parametrize(("seed", "field"), [(-1, 96), (0, 0)])
def test_a_negative_seed_or_no_field_is_refused(seed, field):
    with pytest.raises(AcquisitionError, match="expected from 0 and from 1"):
        random_scene(seed, 0.0, field)
