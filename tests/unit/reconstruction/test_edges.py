"""Edges of still things: where they are, which is nearest, and what points on them tell of cameras."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition.scenes.misplaced import misplaced
from reconstruction.calibration.adjustment import adjust, cost, linearised
from reconstruction.calibration.edge_points import observed, placed, with_edges
from reconstruction.calibration.edges import Edges, find_edges
from reconstruction.calibration.matches import Gate
from reconstruction.calibration.natural import Solution
from reconstruction.calibration.problem import Freedom, Loss, Observations, Problem, ScenePoints, State
from reconstruction.calibration.projection import Cameras, project
from reconstruction.metrics.poses import pose_errors
from rigs.toml import catalog_rig

RIG = catalog_rig("lab3x3")
TRUE = Cameras.of(RIG.cameras)
VIEWS = len(TRUE)
SHAPE = (250, 400)
LINE = 9  # points of a line


def half_plane(angle, offset, shape=(61, 83), dark=0.04, light=0.36):
    """Return light of a half plane blurred by its pixels, whose edge is `offset` px from the middle, and its normal."""
    normal = np.array([np.cos(angle), np.sin(angle)])
    row, column = np.indices(shape)
    fine = (np.arange(20) + 0.5) / 20
    x = column[:, :, None, None] + fine[:, None] - shape[1] / 2
    y = row[:, :, None, None] + fine[None, :] - shape[0] / 2
    share = (x * normal[0] + y * normal[1] > offset).mean(axis=(2, 3))
    tone = dark**0.5 + share * (light**0.5 - dark**0.5)  # features are found in the root of the light
    return (tone**2).astype(np.float32), normal


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.2, np.pi / 2, 2.5, np.pi, -0.8, -2.2])
@pytest.mark.parametrize("offset", [-0.5, -0.2, 0.0, 0.3])
def test_an_edge_is_found_to_a_twentieth_of_a_pixel_and_faces_the_light(angle, offset):
    image, normal = half_plane(angle, offset)
    found = find_edges(image)
    assert len(found) > 30
    off = (found.places - (image.shape[1] / 2, image.shape[0] / 2)) @ normal - offset
    assert np.abs(off).max() < 0.05
    assert (found.normals @ normal).min() > 0.999


@pytest.mark.parametrize(
    "image",
    [np.zeros((40, 40)), np.ones((40, 40)), np.full((9, 9), 1e-30), np.full((8, 1), 0.5), np.full((1, 7), 0.5)],
    ids=["dark", "white", "tiny", "column", "row"],
)
def test_even_pictures_have_no_edges(image):
    found = find_edges(image.astype(np.float32))
    assert len(found) == 0
    _, apart = found.nearest(np.array([[3.0, 3.0], [-1, 2], [np.nan, 0]]), np.array([[1.0, 0], [0, 1], [0, 1]]))
    assert np.isinf(apart).all()


def test_movers_and_texture_have_no_edges():
    image, _ = half_plane(0.0, 0.0)
    moving = np.zeros(image.shape, np.bool_)
    moving[:20] = True
    assert find_edges(image, moving).places[:, 1].min() > 24
    noise = np.random.default_rng(0).random((60, 60)).astype(np.float32)
    assert len(find_edges(noise)) < 0.02 * noise.size


def test_the_nearest_edge_is_that_of_a_search_through_all_that_face_alike():
    rng = np.random.default_rng(1)
    angle = rng.uniform(-np.pi, np.pi, 60)
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    edges = Edges(rng.uniform((0, 0), (83, 61), (60, 2)), normals, np.ones(60), (61, 83))
    places = rng.uniform((0, 0), (83, 61), (200, 2))
    asked = rng.integers(0, 12, 200) * np.pi / 6  # the middles of sectors
    found, apart = edges.nearest(places, np.stack([np.cos(asked), np.sin(asked)], axis=1))
    turned = np.abs(np.angle(np.exp(1j * (angle - asked[:, None]))))
    all_apart = np.linalg.norm(edges.places - places[:, None], axis=2)
    wanted = np.where(turned < np.radians(30), all_apart, np.inf).min(axis=1)
    np.testing.assert_allclose(apart, wanted, atol=1.5)  # the distance transform counts from pixel to pixel
    hit = np.isfinite(apart)
    assert hit.mean() > 0.9
    assert (turned[np.arange(200), found][hit] < np.radians(30)).all()


def lattice():
    """Return points [N, 3] along edges of frames at several depths, and the directions [N, 3] of the edges."""
    rng = np.random.default_rng(4)
    points, along = [], []
    for frame in range(14):
        start = rng.uniform((-0.7, -0.45, 1.4), (0.4, 0.2, 2.8))
        for axis in (0, 1):
            step = np.zeros(3)
            step[axis] = 1.0
            if frame % 3 == 0:
                step[2] = 0.6  # some run into the depth
            points += [start + t * step for t in np.linspace(0, 0.3, LINE)]
            along += [step / np.linalg.norm(step)] * LINE
    return np.array(points), np.array(along)


def seen_edges(points, along, cameras, sd_px=0.0):
    """Return the edges that each camera sees: places each half pixel; a line errs by `sd_px` as a whole."""
    rng, found = np.random.default_rng(6), []
    for view in range(len(cameras)):
        which = np.full(len(points), view)
        fine = np.concatenate([points + 1e-3 * k * along for k in range(-40, 41)])
        at = project(fine, cameras, np.tile(which, 81)).pixels
        ahead = project(fine + 1e-5 * np.tile(along, (81, 1)), cameras, np.tile(which, 81)).pixels - at
        normals = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1) / np.linalg.norm(ahead, axis=1, keepdims=True)
        errs = np.repeat(rng.normal(size=(len(points) // LINE, 1)), LINE, axis=0)
        places = at + sd_px * np.tile(errs, (81, 1)) * normals
        inside = ((places > 0) & (places < SHAPE[::-1])).all(axis=1)
        found.append(Edges(places[inside], normals[inside], np.ones(int(inside.sum())), SHAPE))
    return found


def test_depths_are_those_at_which_other_views_have_an_edge():
    points, along = lattice()
    edges = seen_edges(points, along, TRUE)
    middle = VIEWS // 2
    at = project(points, TRUE, np.full(len(points), middle)).pixels
    own, apart = edges[middle].nearest(at, edges[middle].normals[0] + np.zeros((len(at), 1)))
    own = edges[middle].only(own[apart < 0.5])
    sure, positions = placed(TRUE, edges, middle, own, 1 / np.linspace(1 / 8, 1 / 0.7, 160))
    assert sure.mean() > 0.3
    lines = positions[:, None] - points
    off = np.linalg.norm(np.cross(lines, along), axis=2).min(axis=1)
    assert np.median(off) < 0.02  # m; depths are tried that far apart
    assert (off < 0.05).mean() > 0.9


def test_edges_find_the_cameras_that_few_points_leave_unsure():
    rng = np.random.default_rng(2)
    points, along = lattice()
    edges = seen_edges(points, along, TRUE, 0.02)
    corner = rng.uniform((-0.2, -0.2, 1.8), (0.1, 0.1, 2.1), (30, 3))  # all on a thing in the middle
    camera, block = np.repeat(np.arange(VIEWS), 30), np.tile(np.arange(30), VIEWS)
    pixels = project(corner[block], TRUE, camera).pixels + rng.normal(0, 0.1, (len(block), 2))
    nominal = misplaced(RIG, 0.2, 5)
    cameras = Cameras.of(nominal.cameras)
    freedom = Freedom.poses(VIEWS, 0.02).shared_focal(cameras, 0.02)
    problem = Problem(Observations(camera, block, pixels, np.full(len(block), 0.1)), freedom, Loss("cauchy", 3.0))
    few = Solution(problem, adjust(problem, State(cameras, ScenePoints(corner), np.zeros(len(freedom.prior_sd)))))
    found, count = with_edges(few, edges, Gate(45.0), 1.9)
    assert count > 40
    by_points, by_both = (pose_errors(s.state.cameras.written_to(RIG), RIG, 1.9) for s in (few, found))
    assert by_both.rotation_deg < 0.5 * by_points.rotation_deg
    assert by_both.rotation_deg < 0.08


def test_without_edges_the_solution_stays():
    observations = Observations(np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros((1, 2)), np.ones(1))
    freedom = Freedom.poses(VIEWS, 0.02)
    state = State(TRUE, ScenePoints(np.array([[0.0, 0, 2]])), np.zeros(len(freedom.prior_sd)))
    before = Solution(Problem(observations, freedom, Loss()), state)
    none = [Edges(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), SHAPE)] * VIEWS
    assert with_edges(before, none, Gate(45.0), 1.9) == (before, 0)
    one = [Edges(np.array([[200.0, 125.0]]), np.array([[1.0, 0.0]]), np.ones(1), SHAPE), *none[1:]]
    assert with_edges(before, one, Gate(45.0), 1.9) == (before, 0)


def test_an_edge_is_measured_across_itself_alone():
    points, along = lattice()
    edges = seen_edges(points, along, TRUE)
    at = project(points, TRUE, np.full(len(points), 4)).pixels
    own = edges[4].only(edges[4].nearest(at, np.tile(edges[4].normals[0], (len(at), 1)))[0])
    seen = observed(TRUE, points, edges, 4, own, 3.0)
    freedom = Freedom.poses(VIEWS, 0.02)
    problem = Problem(seen, freedom, Loss("cauchy", 3.0))
    state = State(TRUE, ScenePoints(points + 0.002), np.zeros(len(freedom.prior_sd)))
    at_state = linearised(problem, state)
    assert seen.normals is not None
    across = np.isfinite(seen.normals[:, 0])
    assert across.any()
    assert not across.all()
    tangents = seen.normals[across][:, ::-1] * (1, -1)
    assert np.abs((at_state.residuals[across] * tangents).sum(axis=1)).max() < 1e-9
    for column in range(0, len(freedom.prior_sd), 5):  # gradients are half of the cost's
        step = np.zeros(len(freedom.prior_sd))
        step[column] = 1e-7
        moved = [cost(problem, State(TRUE.moved(freedom.mixing @ (s * step)), state.blocks, s * step)) for s in (1, -1)]
        assert at_state.gradient[column] == pytest.approx((moved[0] - moved[1]) / 4e-7, rel=1e-3, abs=1e-2)
    every = replace(seen, normals=None)
    assert cost(Problem(every, freedom, problem.loss), state) > cost(problem, state)
