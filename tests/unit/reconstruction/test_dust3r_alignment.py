from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
import pytest

from acquisition.scenes.catalog import build_scene
from reconstruction.errors import GeometryError
from reconstruction.initialization.dust3r.alignment import aligned
from reconstruction.initialization.dust3r.initialiser import sampled_pixels
from reconstruction.initialization.dust3r.start import PairMaps, link, registered
from reconstruction.metrics.poses import pose_errors
from rigs.rig import Rig
from rigs.toml import catalog_rig
from rigs.transform import Transform

DISTANCE_M = 1.8
MOST = 400
COMPLETE = tuple(permutations(range(5), 2))


@dataclass(frozen=True, eq=False)
class Views:
    """A rig, where its pixels look [v, n, 2], and what they see, in the rig's frame [v, n, 3]."""

    rig: Rig
    rays: np.ndarray
    points: np.ndarray


@pytest.fixture(scope="module")
def views():
    """Five cameras of the lab's rig on the demo scene."""
    rig = catalog_rig("lab3x3").only(["cam00", "cam02", "cam11", "cam20", "cam22"])
    scene = build_scene("fan_and_ball", 1)
    rows, columns = sampled_pixels(250, 400, MOST)
    rays = np.stack([camera.slopes(np.stack([columns + 0.5, rows + 0.5], axis=-1)) for camera in rig.cameras])
    points = []
    for camera, looks in zip(rig.cameras, rays, strict=True):
        depth = scene.raycaster(camera, 1).frames(*scene.placements(np.zeros(1))).depth[0, rows, columns]
        in_cam = np.concatenate([looks, np.ones_like(looks[:, :1])], axis=1) * depth[:, None]
        points.append(camera.cam_from_rig.inverse().apply(in_cam))
    return Views(rig, rays, np.stack(points))


def said(views, edges, *, noise=0.0, outliers=0.0, seed=0):
    """Imitate a network's answer for each pair: a scale of its own, noise (a fifth sideways), and points anywhere."""
    rng = np.random.default_rng(seed)
    pairs = []
    for a, b in edges:
        first = views.rig.cameras[a].cam_from_rig
        points = np.stack([first.apply(views.points[v]) for v in (a, b)]) * rng.uniform(0.3, 3.0)
        points *= 1 + noise * rng.normal(size=(*points.shape[:2], 1))
        points += 0.2 * noise * points[..., 2:] * rng.normal(size=points.shape)
        anywhere = rng.random(points.shape[:2]) < outliers
        points[anywhere] = rng.normal(0, 2 * np.abs(points).mean(), (int(anywhere.sum()), 3))
        confidence = rng.uniform(2.0, 20.0, points.shape[:2])
        pairs.append(PairMaps(a, b, points.astype(np.float32), confidence.astype(np.float32)))
    return pairs


@pytest.fixture(scope="module")
def noisy(views):
    """Pairs with 0.5% noise in depth and a tenth of all points anywhere, and what they make when aligned."""
    pairs = said(views, COMPLETE, noise=0.005, outliers=0.1)
    return pairs, aligned(views.rig.ids, views.rays, pairs)


def errors_of(found, views):
    """Largest angle in rad and largest shift as a share of the distance."""
    posed = zip(views.rig.cameras, found.cam_from_world, strict=True)
    errors = pose_errors(
        replace(views.rig, cameras=tuple(replace(c, cam_from_rig=p) for c, p in posed)), views.rig, 1.8
    )
    sizes = [np.linalg.norm(e, axis=1).max() for e in (errors.turns_rad, errors.shifts_m)]
    return sizes[0], sizes[1] / DISTANCE_M


def test_exact_point_maps_give_exact_poses(views):
    found = aligned(views.rig.ids, views.rays, said(views, COMPLETE))
    turn, shift = errors_of(found, views)
    assert turn < 1e-5  # float32 point maps
    assert shift < 1e-5
    assert found.residuals.max() < 1e-5


def test_noise_outliers_and_scales_leave_a_thousandth(views, noisy):
    """The outliers claim the same confidence as the others."""
    turn, shift = errors_of(noisy[1], views)
    assert turn < 1e-3  # measured 0.0003
    assert shift < 1e-3
    assert 0.001 < noisy[1].residuals.max() < 0.015


def test_the_order_of_views_and_pairs_does_not_matter(views, noisy):
    order = [3, 0, 4, 1, 2]
    pairs, straight = noisy
    place = {old: new for new, old in enumerate(order)}
    moved = [replace(p, first=place[p.first], second=place[p.second]) for p in reversed(pairs)]
    shuffled = aligned([views.rig.ids[v] for v in order], views.rays[order], moved)
    back = replace(shuffled, cam_from_world=tuple(shuffled.cam_from_world[place[v]] for v in range(5)))
    for one, other in zip(errors_of(straight, views), errors_of(back, views), strict=True):
        assert one == pytest.approx(other, abs=2e-4)


def test_the_same_input_gives_the_same_result(views, noisy):
    pairs, one = noisy
    again = aligned(views.rig.ids, views.rays, pairs)
    assert all(
        np.array_equal(a.matrix, b.matrix) for a, b in zip(one.cam_from_world, again.cam_from_world, strict=True)
    )
    assert np.array_equal(one.points, again.points)


@pytest.mark.slow
def test_points_lie_on_the_scene_and_outliers_earn_less_confidence(views):
    pairs = said(views, COMPLETE, noise=0.005)
    spoilt = np.arange(0, pairs[0].points.shape[1], 7)
    rng = np.random.default_rng(3)
    for pair in pairs:  # the same pixels are wrong in every pair, each time otherwise
        pair.points[:, spoilt] = rng.normal(0, 3, (2, len(spoilt), 3))
    found = aligned(views.rig.ids, views.rays, pairs)
    good = np.setdiff1d(np.arange(found.points.shape[1]), spoilt)
    in_view = found.cam_from_world[2].apply(found.points[2, good])[:, 2]
    truth = views.rig.cameras[2].cam_from_rig.apply(views.points[2, good])[:, 2]
    ratio = in_view / truth
    assert np.median(np.abs(ratio / np.median(ratio) - 1)) < 0.005
    assert np.median(found.confidence[:, spoilt]) < 0.3 * np.median(found.confidence[:, good])


def test_a_view_that_the_network_is_not_sure_of_is_refused_by_name(views):
    pairs = said(views, COMPLETE)
    doubtful = [
        replace(p, confidence=np.full_like(p.confidence, 1.01)) if 1 in (p.first, p.second) else p for p in pairs
    ]
    with pytest.raises(
        GeometryError, match="found no overlap of cam02 with the other views, expected some; leave it out"
    ):
        aligned(views.rig.ids, views.rays, doubtful)


def test_a_view_that_no_pose_explains_is_refused_by_name(views):
    rng = np.random.default_rng(1)
    pairs = said(views, COMPLETE)
    for pair in pairs:
        for side in (0, 1):
            if 3 in (pair.first, pair.second):
                pair.points[side] = rng.normal(0, 1, pair.points[side].shape)
    with pytest.raises(GeometryError, match="no overlap of cam20 with"):
        aligned(views.rig.ids, views.rays, pairs)


@pytest.mark.slow
def test_a_view_that_every_pair_puts_elsewhere_is_refused_by_name(views):
    """Each pair with it makes sense alone; together they do not."""
    rng = np.random.default_rng(2)
    pairs = said(views, COMPLETE)
    for pair in pairs:
        if 4 in (pair.first, pair.second):
            other = int(pair.first == 4)
            turn = Transform.from_rotvec(rng.normal(0, 0.5, 3), rng.normal(0, 1, 3))
            pair.points[other] = (turn.apply(pair.points[other]) * rng.uniform(0.5, 2)).astype(np.float32)
    with pytest.raises(GeometryError, match="pairs that disagree on cam22 by"):
        aligned(views.rig.ids, views.rays, pairs)


def test_points_that_are_not_finite_count_for_nothing(views):
    pairs = said(views, COMPLETE, noise=0.005)
    for pair in pairs:
        pair.points[0, ::9] = np.nan
        pair.confidence[1, ::11] = np.inf
    turn, shift = errors_of(aligned(views.rig.ids, views.rays, pairs), views)
    assert turn < 1e-3
    assert shift < 1e-3


@pytest.mark.parametrize("shape", ["one place", "a line", "nothing", "behind"])
def test_maps_without_sense_are_refused(views, shape):
    pairs = said(views, COMPLETE)
    for pair in pairs:
        match shape:
            case "one place":
                pair.points[:] = (0.1, 0.2, 1.0)
            case "a line":
                pair.points[..., :2] = 0.0
            case "nothing":
                pair.points[:] = 0.0
            case "behind":
                pair.points[:] *= -1
    with pytest.raises(GeometryError, match=r"found no overlap of cam00|behind their camera"):
        aligned(views.rig.ids, views.rays, pairs)


def test_registration_outvotes_outliers():
    rng = np.random.default_rng(4)
    source = rng.normal(size=(300, 3))
    turn = Transform.from_rotvec((0.4, -1.1, 0.7))
    target = 2.5 * source @ turn.rotation.T + (1, 2, 3)
    target[:90] += rng.normal(0, 5, (90, 3))
    found = registered(source, target, np.ones(300))
    assert found.scale == pytest.approx(2.5, rel=1e-6)
    assert np.allclose(found.rotation, turn.rotation, atol=1e-6)
    assert np.allclose(found.translation, (1, 2, 3), atol=1e-5)
    mirrored = registered(source, source * (1, 1, -1), np.ones(300))
    assert np.linalg.det(mirrored.rotation) == pytest.approx(1)


def test_a_link_is_the_pose_of_the_second_camera(views):
    (pair,) = said(views, [(0, 3)], noise=0.002)
    found = link(pair, views.rays)
    a, b = (views.rig.cameras[v].cam_from_rig for v in (0, 3))
    expected = b @ a.inverse()
    assert np.allclose(found.second_from_first.rotation, expected.rotation, atol=2e-3)
    shift = found.second_from_first.translation
    assert shift @ expected.translation / np.linalg.norm(shift) / np.linalg.norm(expected.translation) > 0.999


def test_samples():
    rows, columns = sampled_pixels(250, 400, 2000)
    assert len(rows) == len(columns) <= 2000
    assert rows.max() < 250
    assert columns.max() < 400
    assert len(set(zip(rows.tolist(), columns.tolist(), strict=True))) == len(rows) > 1500
