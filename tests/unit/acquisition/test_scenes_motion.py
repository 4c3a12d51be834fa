"""Joints, sheets, impacts and changing light against the laws they follow."""

import itertools
import math

import numpy as np
import pytest

from acquisition.errors import AcquisitionError
from acquisition.scenes.bodies import Body, Finish, Shape, about, at, still
from acquisition.scenes.catalog import build_scene
from acquisition.scenes.collision import Thrown, thrown
from acquisition.scenes.light import Flicker, Uneven
from acquisition.scenes.linkage import Hinge, Strip, Sway, Wave
from acquisition.scenes.motion import Motion
from acquisition.scenes.scene import Scene
from rigs.camera import Camera
from rigs.transform import Transform

VIEW = Camera("cam11", 40, 30, 35.0, 35.0, 20.0, 15.0, Transform.identity())
GREY = np.full((1, 4, 4), 0.5, dtype=np.float32)
BALL = Shape("sphere", (0.2,), Finish(0, 0.1, (0.0, 1.0)))
TIMES = np.linspace(-0.3, 0.4, 29)


def placed(z: float = 2.0) -> Motion:
    return Motion(Transform(np.eye(3), np.array([0.0, 0.0, z])))


def only(*bodies: Body, **light) -> Scene:
    return Scene("test", 0, bodies, GREY, (0, 0, 2), (0.0, 0.0, -1.0), **light)


def rotations_are_rotations(rotations):
    np.testing.assert_allclose(
        rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (len(rotations), 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=1e-12)


def test_a_hinge_swings_about_its_joint_and_carries_what_hangs_on_it():
    trunk = Motion(Transform.identity(), velocity_m_s=(2.0, 0.0, 0.0))
    thigh = Hinge(trunk, at(0.0, 0.1, 0.0), swing_rad=0.8, rate_rad_s=5.0, phase_rad=0.3)
    shin = Hinge(thigh, at(0.0, 0.4, 0.0), rest_rad=0.5)
    upper, hip = thigh.world_from_body(TIMES)
    lower, knee = shin.world_from_body(TIMES)
    angles = 0.8 * np.sin(5 * TIMES + 0.3)
    np.testing.assert_allclose(hip, np.stack([2 * TIMES, 0.1 + 0 * TIMES, 0 * TIMES], axis=-1), atol=1e-12)
    np.testing.assert_allclose(
        knee - hip, 0.4 * np.stack([-np.sin(angles), np.cos(angles), 0 * angles], axis=-1), atol=1e-12
    )
    np.testing.assert_allclose(lower, upper @ about(2, 0.5), atol=1e-12)
    assert thigh.moving
    assert shin.moving
    assert not Hinge(placed(), at(0, 0, 0), rest_rad=1.0).moving


def test_a_sheet_keeps_its_length_and_its_strips_together():
    wave = Wave(Transform(about(1, 0.4), np.array([1.0, 2.0, 3.0])), 12, 0.03, 0.6, 40.0, 0.5)
    poses = [Strip(wave, i).world_from_body(TIMES) for i in range(12)]
    edge = np.array([0.015, 0.0, 0.0])
    np.testing.assert_allclose(poses[0][1] - poses[0][0] @ edge, np.tile([1.0, 2.0, 3.0], (len(TIMES), 1)), atol=1e-12)
    for (turned, middle), (next_turned, next_middle) in itertools.pairwise(poses):
        rotations_are_rotations(turned)
        np.testing.assert_allclose(middle + turned @ edge, next_middle - next_turned @ edge, atol=1e-12)
    assert np.ptp(poses[-1][1][:, 0]) > 0.01


def test_a_waved_thing_comes_back_and_reaches_as_far_as_it_says():
    sway = Sway(Transform.identity(), (0.2, 0.1, 0.0), (0.3, 0.0, 0.2), (10.0, 20.0, 0.0), (10.0, 0.0, 20.0))
    period = 2 * math.pi / 10
    (now, here), (later, there) = sway.world_from_body(TIMES), sway.world_from_body(TIMES + period)
    rotations_are_rotations(now)
    np.testing.assert_allclose(now, later, atol=1e-9)
    np.testing.assert_allclose(here, there, atol=1e-9)
    reach = abs(sway.world_from_body(np.linspace(0, period, 2001))[1]).max(axis=0)
    np.testing.assert_allclose(reach, [0.2, 0.1, 0.0], atol=1e-4)


def velocities(pieces, instant_s: float) -> np.ndarray:
    h = 1e-7
    before, after = pieces.world_from_body(np.array([instant_s - h, instant_s + h]))[1]
    return (after - before) / (2 * h)


def test_an_impact_keeps_momentum_and_energy_and_happens_where_surfaces_touch():
    a = Thrown((0.0, 0.0, 0.0), (4.0, 0.2, 0.1), 0.1, 1.0)
    b = Thrown((0.5, 0.05, 0.02), (-3.0, 0.5, 0.0), 0.15, 2.5)
    first, second = thrown((a, b), until_s=1.0)
    (_, instant_s), (_, same) = first.starts_s, second.starts_s
    assert instant_s == same
    touching = first.world_from_body(np.array([instant_s]))[1] - second.world_from_body(np.array([instant_s]))[1]
    assert np.linalg.norm(touching) == pytest.approx(0.25, abs=1e-12)
    times = np.linspace(0, 0.2, 400)
    apart = np.linalg.norm(first.world_from_body(times)[1] - second.world_from_body(times)[1], axis=-1)
    assert apart.min() >= 0.25 - 1e-9
    before = [velocities(p, instant_s - 1e-6) for p in (first, second)]
    after = [velocities(p, instant_s + 1e-6) for p in (first, second)]
    np.testing.assert_allclose(before[0] + 2.5 * before[1], after[0] + 2.5 * after[1], atol=1e-4)
    energies = [(v[0] ** 2).sum() + 2.5 * (v[1] ** 2).sum() for v in (before, after)]
    assert energies[0] == pytest.approx(energies[1], abs=1e-3)
    assert np.linalg.norm(after[0] - before[0]) > 1


def test_things_fly_on_without_a_jump_and_may_meet_again_and_again():
    row = [Thrown((0.3 * i, 0.0, 0.0), (3.0 if i == 0 else 0.0, 0.0, 0.0), 0.1) for i in range(4)]
    flights = thrown(row, until_s=0.5)
    assert [len(pieces.flights) for pieces in flights] == [2, 3, 3, 2]  # the push runs down the row
    for pieces in flights:
        for instant_s in pieces.starts_s[1:]:
            _, (before, after) = pieces.world_from_body(np.array([instant_s - 1e-9, instant_s]))
            np.testing.assert_allclose(before, after, atol=1e-7)
    assert velocities(flights[3], 0.45) == pytest.approx([3.0, 9.81 * 0.45, 0.0], abs=1e-5)


def test_bodies_that_never_meet_fly_free():
    lone, other = thrown((Thrown((0, 0, 0), (1, 0, 0), 0.1), Thrown((0, 5, 0), (1, 0, 0), 0.1)), until_s=9.0)
    assert len(lone.flights) == len(other.flights) == 1
    np.testing.assert_allclose(
        lone.world_from_body(np.array([-1.0, 2.0]))[1], [[-1, 4.905, 0], [2, 19.62, 0]], atol=1e-12
    )


def test_a_body_is_there_only_from_and_up_to_its_instants():
    scene = only(
        still("wall", (0, 0, 3), Shape("rectangle", (9, 9), BALL.finish)), Body("spark", (BALL,), placed(), 0.1, 0.2)
    )
    frames = scene.render(VIEW, np.array([0.0, 0.1, 0.15, 0.2, 5.0]), 2)
    assert ((frames.ids == 2).any(axis=(1, 2)) == [False, True, True, False, False]).all()
    without = only(scene.bodies[0]).render(VIEW, np.zeros(1), 2)
    for gone in (0, 3, 4):  # nor does it throw a shadow
        np.testing.assert_array_equal(frames.intensity[gone], without.intensity[0])
        np.testing.assert_array_equal(frames.depth[gone], without.depth[0])
    assert scene.movers == {"spark": 2}


def test_flicker_scales_every_light_alike():
    flicker = Flicker(100.0, 0.8)
    times = np.array([0.0, 0.0025, 0.005, 0.01, 0.0175])
    np.testing.assert_allclose(flicker.gains(times), [1, 0.6, 0.2, 1, 0.6], atol=1e-12)
    shining, steady = only(Body("ball", (BALL,), placed()), flicker=flicker), only(Body("ball", (BALL,), placed()))
    seen, plain = (scene.render(VIEW, times, 2) for scene in (shining, steady))
    np.testing.assert_allclose(seen.intensity, plain.intensity * flicker.gains(times)[:, None, None], rtol=1e-6)
    np.testing.assert_array_equal(seen.depth, plain.depth)


def test_uneven_light_follows_its_slope_between_its_limits():
    wall = still("wall", (0, 0, 2.0), Shape("rectangle", (9, 9), BALL.finish))
    frames = only(wall, uneven=Uneven((0.8, -0.3, 0.0), 0.7, 0.2)).render(VIEW, np.zeros(1), 1)
    x, y = np.meshgrid((np.arange(40) + 0.5 - 20) / 35 * 2, (np.arange(30) + 0.5 - 15) / 35 * 2)
    share = np.clip(0.7 + 0.8 * x - 0.3 * y, 0.2, 1)
    assert share.min() == 0.2
    assert share.max() == 1
    np.testing.assert_allclose(frames.intensity[0], 0.6 * 0.5 * share, rtol=1e-6)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Body("b", (BALL, BALL), (placed(),)), "1 motions of 2 shapes"),
        (lambda: Body("b", (BALL,), placed(), 0.2, 0.2), "expected a time between"),
        (lambda: Flicker(0.0, 0.5), "flicker"),
        (lambda: Flicker(50.0, 1.5), "flicker"),
        (lambda: Uneven((0.0, 0.0, 0.0), 1.0, -0.1), "least light"),
    ],
)
def test_impossible_bodies_and_lights_are_refused(make, words):
    with pytest.raises(AcquisitionError, match=words):
        make()


def test_stress_scenes_have_the_one_difficulty_they_are_named_for():
    assert not build_scene("static", 1).movers
    stiff = build_scene("stiff", 1)
    positions = stiff.placements(np.array([0.005, 0.005001])).positions
    fast, slow = (stiff.arrays.ids == stiff.object_ids[name] for name in ("fast_ball", "slow_ball"))
    pixels_per_ms = 350 * np.linalg.norm(positions[1] - positions[0], axis=-1) / 1e-6 / positions[0, :, 2] / 1000
    assert pixels_per_ms[fast].item() > 10
    assert 0 < pixels_per_ms[slow].item() < 0.1
    gains = build_scene("flicker", 1).placements(np.linspace(0, 0.01, 11)).gains
    assert gains.max() / gains.min() > 4
    white = {name: build_scene(name, 1).white for name in ("dim", "bright")}
    assert white == {"dim": 0.01, "bright": 0.95}
    view = build_scene("outdoor", 1).render(VIEW, np.zeros(1), 1).intensity[0]
    assert view[:, 30:].mean() > 3 * view[:, :10].mean()
    burst = build_scene("burst", 1)
    sparks = np.isin(burst.render(VIEW, np.array([0.00795, 0.008]), 1).ids, list(burst.movers.values())).mean(
        axis=(1, 2)
    )
    assert sparks[0] == 0
    assert sparks[1] > 0.05
