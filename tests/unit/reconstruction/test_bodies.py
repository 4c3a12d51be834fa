"""Registration and rigid bodies from points at a few instants, against motions that are known."""

import numpy as np
import pytest
from references.stereo import linked_reference, matches_of, soft_matches_reference

from reconstruction.initialization.bodies import LONE, UNLIKE, Bodies, find_bodies
from reconstruction.initialization.points import Points, spacing
from reconstruction.initialization.registration import linked, register, rigid_fit, soft_matches
from rigs.transform import Transform

INSTANTS = 5
TIMES_S = [i / 100 for i in range(INSTANTS)]


def turn(angle_rad: float, axis: str = "z") -> np.ndarray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array({"z": [[c, -s, 0], [s, c, 0], [0, 0, 1]], "x": [[1, 0, 0], [0, c, -s], [0, s, c]]}[axis])


def board(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of a bent board 0.4 m x 0.3 m and their texture of waves a few centimetres long."""
    x, y = rng.uniform(-0.2, 0.2, n), rng.uniform(-0.15, 0.15, n)
    light = 0.3 + 0.1 * np.sin(90 * x) * np.cos(70 * y) + 0.1 * np.sin(40 * (x + y))
    return np.stack([x, y, 0.8 * x**2], axis=1), light.astype(np.float32)


@pytest.mark.parametrize("count", [0, 1, 2, 9, 300])
@pytest.mark.parametrize("gap_m", [0.0, 0.03, 0.1, 5.0])
def test_joined_points_are_those_of_the_twin(count, gap_m):
    positions = np.random.default_rng(count).random((count, 3)) * (1, 1, 0.1)
    positions[count // 2 :: 7] = positions[: len(positions[count // 2 :: 7])]  # twins
    np.testing.assert_array_equal(linked(positions, gap_m), linked_reference(positions, gap_m))


def test_points_that_are_nowhere_are_joined_to_none():
    nan, inf = np.nan, np.inf
    positions = np.array([[0, 0, 0], [nan, 0, 0], [0.1, 0, 0], [inf, 0, 0], [inf, 0, 0], [0, nan, 0], [-inf, 0, 0]])
    assert linked(positions, 0.2).tolist() == [0, 1, 0, 2, 3, 4, 5]


def seen(parts: list[tuple[np.ndarray, np.ndarray]], instant: int) -> Points:
    positions = np.concatenate([p for p, _ in parts])
    light = np.concatenate([x for _, x in parts]).astype(np.float32)
    return Points(positions, light, spacing(positions), np.full(len(positions), instant / 100))


def pose(instant: int, bounce: bool = False) -> Transform:
    """Half a radian in all about z, 6 cm along x; a bounce turns back at the third instant."""
    way = min(instant, 4 - instant) if bounce else instant
    return Transform(turn(0.12 * way), np.array([0.015 * way, 0.02 * way * bounce, 1.5]))


def clip(n: int = 250, bounce: bool = False, noise_m: float = 0.002) -> Points:
    """Other points of the same board at every instant."""
    rng = np.random.default_rng(3)
    parts = []
    for i in range(INSTANTS):
        positions, light = board(rng, n)
        positions = pose(i, bounce).apply(positions) + rng.normal(0, noise_m, positions.shape)
        parts.append(seen([(positions, light + rng.normal(0, 0.01, n).astype(np.float32))], i))
    return Points.joined(parts)


def errors(bodies: Bodies, bounce: bool = False) -> tuple[float, float]:
    """Worst angle (degrees) and worst shift (mm) of body 0 since its first instant."""
    poses = [Transform.from_quat_wxyz(q, c) for q, c in zip(bodies.quats_wxyz[0], bodies.centers[0], strict=True)]
    angles, shifts = [], []
    for i in range(INSTANTS):
        found = poses[i] @ poses[0].inverse()
        true = pose(i, bounce) @ pose(0, bounce).inverse()
        cosine = (np.trace(found.rotation @ true.rotation.T) - 1) / 2
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
        shifts.append(1000 * np.linalg.norm(found.apply(poses[0].translation) - true.apply(poses[0].translation)))
    return max(angles), max(shifts)


def test_the_rigid_fit_finds_the_pose_of_known_pairs():
    rng = np.random.default_rng(0)
    model = rng.normal(size=(20, 3))
    true = Transform(turn(2.5) @ turn(-1.1, "x"), np.array([1.0, -2.0, 3.0]))
    found = rigid_fit(matches_of(model, true.apply(model), np.eye(20), np.zeros((20, 20))))
    np.testing.assert_allclose(found.rotation, true.rotation, atol=1e-7)
    np.testing.assert_allclose(found.translation, true.translation, atol=1e-7)


def test_points_in_a_plane_are_fitted_by_a_rotation_not_a_mirror():
    rng = np.random.default_rng(0)
    flat = rng.normal(size=(20, 3)) * [1, 1, 0]
    found = rigid_fit(matches_of(flat, flat @ turn(3.0).T, np.eye(20), np.zeros((20, 20))))
    assert np.linalg.det(found.rotation) == pytest.approx(1)


@pytest.mark.parametrize("width", [1e-3, 0.05, 10.0])
def test_soft_matches_are_those_of_the_twin(width):
    rng = np.random.default_rng(4)
    (a, light_a), (b, light_b) = board(rng, 70), board(rng, 90)
    model, target = (a.astype(np.float32), light_a), (b.astype(np.float32) + np.float32(2), light_b)
    guess = Transform(turn(0.2, "x"), np.array([2.01, 1.99, 2.0]))
    found, twin = (f(model, target, guess, width, 0.3) for f in (soft_matches, soft_matches_reference))
    for name in ("total", "squared", "model", "target", "cross"):
        np.testing.assert_allclose(getattr(found, name), getattr(twin, name), rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 2e3])
def test_registration_is_the_same_at_every_scale_of_the_scene(scale):
    """Matches are normalised, so weights that underflow at one scale do not matter."""
    rng = np.random.default_rng(1)
    (a, light_a), (b, light_b) = board(rng, 300), board(rng, 300)
    true = Transform(turn(0.1), np.array([0.01, 0.0, 0.005]))
    model, target = (
        Points((at * scale).astype(np.float32), light, np.full(300, 0.01 * scale), np.zeros(300))
        for at, light in ((a, light_a), (true.apply(b), light_b))
    )
    found = register(model, target, Transform.identity(), 0.05 * scale, 0.012 * scale)
    assert np.abs(found.rotation - true.rotation).max() < 0.02
    assert np.abs(found.translation / scale - true.translation).max() < 0.003


@pytest.mark.parametrize("bounce", [False, True])
def test_a_rigid_motion_is_recovered(bounce):
    bodies = find_bodies(clip(bounce=bounce), TIMES_S)
    assert len(bodies) == 1
    assert bodies.attached > 0.95 * INSTANTS * 250
    assert bodies.seen.tolist() == [[0, INSTANTS - 1]]
    angle_deg, shift_mm = errors(bodies, bounce)
    assert angle_deg < 1.5
    assert shift_mm < 5


def test_two_bodies_with_motions_of_their_own_are_told_apart():
    moving, rng = clip(), np.random.default_rng(5)
    parts = []
    for i in range(INSTANTS):
        at = moving.instants_s == i / 100
        positions, light = board(rng, 120)
        other = positions @ turn(-0.1 * i).T + [0.6, 0.02 * i, 1.4]
        parts.append(seen([(moving.positions[at], moving.intensities[at]), (other, light)], i))
    bodies = find_bodies(Points.joined(parts), TIMES_S)
    assert len(bodies) == 2
    owners = bodies.owners.reshape(INSTANTS, -1)
    assert (owners[:, :250] != 1).all()
    assert (owners[:, 250:] != 0).all()
    assert errors(bodies)[0] < 1.5


@pytest.mark.parametrize("gap_m", [0.052, 0.15])
def test_two_bodies_that_touch_at_first_are_told_apart_by_where_they_are_not(gap_m):
    """One cluster until the fourth instant; a gap of 2.5 spacings or of more at the last two."""
    rng, parts, sizes = np.random.default_rng(6), [], (250, 250)
    for i in range(INSTANTS):
        gap = gap_m if i > 2 else 0.03
        for side, n in zip((-1, 1), sizes, strict=True):
            positions, light = board(rng, n)
            way = np.array([side * (0.2 + gap / 2), side * 0.015 * i, 1.5])
            parts.append(seen([(positions + way, light)], i))
    bodies = find_bodies(Points.joined(parts), TIMES_S)
    assert len(bodies) == 2
    owners = bodies.owners.reshape(INSTANTS, 2, 250)
    same = [(owners[:, k] == owners[0, k, 0]).mean() for k in (0, 1)]
    assert min(same) > 0.85
    assert owners[0, 0, 0] != owners[0, 1, 0]


@pytest.mark.parametrize("strays", [0, 12])
def test_a_body_that_leaves_keeps_the_poses_it_had_and_goes_on(strays):
    """Seen at three of five instants; then nothing is, or only strays are."""
    early = clip().select(clip().instants_s < 0.025)
    late = clip().select(clip().instants_s >= 0.025).select(np.arange(strays))
    away = Points(late.positions + 50.0, late.intensities, late.spacing, late.instants_s)
    bodies = find_bodies(Points.joined([early, away]), TIMES_S)
    assert len(bodies) == 1
    assert bodies.centers.shape == (1, INSTANTS, 3)
    assert bodies.seen.tolist() == [[0, 2]]
    assert (bodies.owners[len(early) :] == -1).all()
    assert errors(bodies)[1] < 12  # two instants beyond the last one seen


def test_what_moves_slowly_is_a_body():
    """By less than half of the gap between its points from one instant to the next."""
    rng, step = np.random.default_rng(2), np.array([0.006, 0.0, 0.0])
    boards = [board(rng, 250) for _ in range(INSTANTS)]
    swept = [seen([(positions + i * step, light)], i) for i, (positions, light) in enumerate(boards)]
    assert step[0] < 0.5 * np.median(swept[0].spacing)
    bodies = find_bodies(Points.joined(swept), TIMES_S)
    assert len(bodies) == 1
    assert bodies.attached > 0.95 * 250 * INSTANTS
    moved = bodies.centers[0, -1] - bodies.centers[0, 0]
    assert moved == pytest.approx((INSTANTS - 1) * step, abs=0.004)


def test_bodies_that_are_left_out_leave_their_points_free():
    bodies = find_bodies(clip(), TIMES_S)
    none = bodies.only(np.zeros(0, np.int64))
    assert len(none) == none.attached == 0
    assert none.free[UNLIKE] == bodies.attached
    assert bodies.only(np.arange(len(bodies))).owners.tolist() == bodies.owners.tolist()


@pytest.mark.parametrize("n", [0, 1, 30])
def test_too_few_points_make_no_body_and_say_so(n):
    bodies = find_bodies(clip(n) if n else Points.none(), TIMES_S)
    assert len(bodies) == bodies.attached == 0
    assert bodies.free == ({LONE: n * INSTANTS} if n else {})
