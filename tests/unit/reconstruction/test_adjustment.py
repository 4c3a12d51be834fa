"""Projection, bundle adjustment and what they say of their own errors."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition.scenes.misplaced import misplaced
from reconstruction.calibration.adjustment import adjust, cost, covariance, linearised
from reconstruction.calibration.calibrated import aligning, camera_sds
from reconstruction.calibration.problem import BoardPoses, Freedom, Loss, Observations, Problem, ScenePoints, State
from reconstruction.calibration.projection import PARAMETERS, Cameras, project
from reconstruction.metrics.poses import pose_errors
from rigs.toml import catalog_rig
from rigs.transform import rotations

RIG = catalog_rig("lab3x3")
TRUE = Cameras.of(RIG.cameras)
VIEWS = len(RIG.cameras)


def seen_points(count, rng, sd_px, share=0.6):
    points = np.stack([rng.uniform(-0.7, 0.7, count), rng.uniform(-0.45, 0.45, count), rng.uniform(1.3, 3, count)], 1)
    camera, block = np.repeat(np.arange(VIEWS), count), np.tile(np.arange(count), VIEWS)
    pixels = project(points[block], TRUE, camera).pixels
    kept = (rng.random(len(camera)) < share) & ((pixels > 0) & (pixels < (400, 250))).all(axis=1)
    noisy = pixels + rng.normal(0, sd_px, pixels.shape)
    return points, Observations(camera[kept], block[kept], noisy[kept], np.full(kept.sum(), max(sd_px, 1e-3)))


def posed_problem(observations, cameras, loss=None, center_sd_m=0.02):
    freedom = Freedom.poses(VIEWS, center_sd_m).shared_focal(cameras, 0.02)
    return Problem(observations, freedom, loss or Loss())


def started(problem, cameras, points):
    return State(cameras, ScenePoints(points), np.zeros(len(problem.freedom.prior_sd)))


def errors(cameras):
    return pose_errors(cameras.written_to(RIG), RIG, 1.9)


def test_derivatives_of_the_projection_are_those_of_finite_differences():
    rng = np.random.default_rng(0)
    fisheye = np.arange(VIEWS) % 3 == 1
    bent = replace(TRUE, lenses=TRUE.lenses + np.array([0, 3, 1, -2, 0.05, -0.02, 0.01, -0.01, 0.03]), fisheye=fisheye)
    points, which = rng.uniform((-0.7, -0.4, 1.2), (0.7, 0.4, 3), (60, 3)), rng.integers(0, VIEWS, 60)
    found = project(points, bent, which)
    for k in range(len(PARAMETERS)):
        step = np.zeros((VIEWS, len(PARAMETERS)))
        step[:, k] = 1e-6
        apart = project(points, bent.moved(step), which).pixels - project(points, bent.moved(-step), which).pixels
        np.testing.assert_allclose(apart / 2e-6, found.by_camera[:, :, k], rtol=1e-5, atol=1e-4)
    for axis, shift in enumerate(1e-6 * np.eye(3)):
        apart = project(points + shift, bent, which).pixels - project(points - shift, bent, which).pixels
        np.testing.assert_allclose(apart / 2e-6, found.by_point[:, :, axis], rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize(
    ("model", "distortion"), [("opencv", (-0.2, 0.05, 0.002, -0.001, 0.01)), ("fisheye", (-0.02, 0.01, 0.0, 0.001))]
)
def test_cameras_project_as_the_rig_does_and_look_back(model, distortion):
    rng = np.random.default_rng(0)
    cameras = tuple(replace(c, lens_model=model, distortion=distortion) for c in RIG.cameras)
    some = Cameras.of(cameras)
    points = rng.uniform((-0.7, -0.4, 1.2), (0.7, 0.4, 3), (60, 3))
    for number, camera in enumerate(cameras):
        which = np.full(60, number)
        found = project(points, some, which).pixels
        np.testing.assert_allclose(found, camera.project(points)[0], atol=1e-9)
        inside = camera.cam_from_rig.apply(points)
        np.testing.assert_allclose(some.slopes(found, which), inside[:, :2] / inside[:, 2:], atol=1e-9)
    assert some.written_to(RIG).cameras[3].distortion == distortion


def test_points_behind_a_camera_are_not_seen_and_have_no_derivatives():
    found = project(np.array([[0.0, 0, -2], [0, 0, 0], [0, 0, 2]]), TRUE, np.array([4, 4, 4]))
    assert found.seen.tolist() == [False, False, True]
    assert np.isfinite(found.pixels).all()
    assert not found.by_camera[:2].any()
    assert not found.by_point[:2].any()


@pytest.mark.parametrize("error", [0.5, 2, 5])
def test_exact_observations_give_exact_cameras(error):
    rng = np.random.default_rng(1)
    points, observations = seen_points(150, rng, 0.0)
    nominal = Cameras.of(misplaced(RIG, error, 3).cameras)
    problem = posed_problem(observations, nominal, center_sd_m=1e3)
    problem = replace(problem, freedom=replace(problem.freedom, prior_sd=np.minimum(problem.freedom.prior_sd, 1e3)))
    found = adjust(problem, started(problem, nominal, points + rng.normal(0, 0.1, points.shape)), 100, 1e-12)
    off = errors(found.cameras)
    assert off.rotation_deg < 1e-5
    assert off.translation_percent < 1e-5
    assert off.focal_percent < 1e-4  # the prior of 2% pulls at it


def test_a_board_whose_corners_are_known_gives_its_poses():
    rng = np.random.default_rng(2)
    corners = np.stack([*np.meshgrid(np.arange(6) * 0.1, np.arange(4) * 0.1), np.zeros((4, 6))], -1).reshape(-1, 3)
    turns, shifts = rotations(rng.normal(0, 0.3, (5, 3))), rng.uniform((-0.4, -0.3, 1.3), (0.0, 0.0, 1.8), (5, 3))
    camera, block, corner = (a.ravel() for a in np.meshgrid(np.arange(VIEWS), np.arange(5), np.arange(24)))
    true = BoardPoses(turns, shifts, corners[corner])
    pixels = project(true.place(block)[0], TRUE, camera).pixels
    problem = Problem(Observations(camera, block, pixels, np.ones(len(camera))), Freedom.poses(VIEWS, 10.0), Loss())
    off = BoardPoses(turns @ rotations(np.full(3, 0.1)), shifts + 0.05, corners[corner])
    start = State(Cameras.of(misplaced(RIG, 1, 1).cameras), off, np.zeros(len(problem.freedom.prior_sd)))
    start = replace(start, cameras=replace(start.cameras, lenses=TRUE.lenses))
    found = adjust(problem, start, 100, 1e-12)
    assert np.abs(linearised(problem, found).residuals).max() < 1e-4
    assert errors(found.cameras).rotation_deg < 1e-4


def test_the_adjustment_agrees_with_pycolmap():
    pycolmap = pytest.importorskip("pycolmap")
    rng = np.random.default_rng(4)
    points, observations = seen_points(200, rng, 0.3)
    problem = Problem(observations, Freedom.poses(VIEWS, 1e3), Loss())
    ours = adjust(problem, started(problem, TRUE, points), 50, 1e-12)
    scene = pycolmap.Reconstruction()
    for i, camera in enumerate(RIG.cameras):
        scene.add_camera_with_trivial_rig(
            pycolmap.Camera(camera_id=i + 1, model="PINHOLE", width=400, height=250, params=TRUE.lenses[i, :4])
        )
        own = np.flatnonzero(observations.camera == i)
        image = pycolmap.Image(name=camera.id, keypoints=observations.pixels[own], camera_id=i + 1, image_id=i + 1)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(TRUE.rotations[i]), camera.cam_from_rig.translation)
        scene.add_image_with_trivial_frame(image, pose)
    for block, point in enumerate(points):
        track = pycolmap.Track()
        for o in np.flatnonzero(observations.block == block):
            camera = observations.camera[o]
            track.add_element(int(camera) + 1, int((observations.camera[:o] == camera).sum()))
        if track.length() > 1:
            scene.add_point3D(point, track)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_extra_params = options.print_summary = False
    pycolmap.bundle_adjustment(scene, options)
    poses = [scene.images[i + 1].cam_from_world() for i in range(VIEWS)]
    theirs = Cameras(
        np.array([p.rotation.matrix() for p in poses]),
        np.array([-p.rotation.matrix().T @ p.translation for p in poses]),
        TRUE.lenses,
        TRUE.fisheye,
    )
    apart = pose_errors(
        theirs.written_to(RIG),
        ours.cameras.written_to(RIG),
        1.9,
    )
    assert apart.rotation_deg < 1e-4  # they differ by .008 degrees from the truth
    assert apart.translation_percent < 1e-3


def test_the_reported_spread_is_that_of_many_draws():
    nominal, found, said = Cameras.of(RIG.cameras), [], []
    for seed in range(12):
        points, observations = seen_points(120, np.random.default_rng(seed), 0.2)
        problem = posed_problem(observations, nominal, center_sd_m=1.0)
        state = adjust(problem, started(problem, nominal, points), 30)
        off = errors(state.cameras)
        found.append(np.degrees(np.linalg.norm(off.turns_rad, axis=1)))
        sds = camera_sds(covariance(problem, state), problem.freedom, state.cameras, metric=False)
        said.append([sd.rotation_deg for sd in sds])
    real, reported = np.sqrt(np.mean(np.square(found))), np.sqrt(np.mean(np.square(said)))
    assert 0.5 < real / reported < 1.0  # camera_sds doubles variances on purpose: 0.71 expected


def test_what_alignment_takes_away_is_no_error():
    rng = np.random.default_rng(5)
    step = np.zeros((VIEWS, len(PARAMETERS)))
    step[:, :6] = 1e-6 * rng.normal(size=(VIEWS, 6))
    off = errors(TRUE.moved(step))
    left = (aligning(TRUE, metric=False) @ step[:, :6].ravel()).reshape(VIEWS, 6)
    np.testing.assert_allclose(left[:, :3], off.turns_rad, atol=1e-11)
    np.testing.assert_allclose(left[:, 3:], off.shifts_m, atol=1e-10)


@pytest.mark.parametrize("kind", ["squares", "huber", "cauchy"])
def test_weights_are_the_slope_of_the_cost(kind):
    loss, squared = Loss(kind, 2.0), np.array([0.0, 0.3, 3.9, 4.1, 50.0, 1e8])
    step = 1e-6 * (1 + squared)
    slope = (loss.cost(squared + step) - loss.cost(np.maximum(squared - step, 0))) / (
        squared + step - np.maximum(squared - step, 0)
    )
    np.testing.assert_allclose(loss.weight(squared), slope, rtol=1e-4, atol=1e-9)


def test_a_camera_and_a_point_that_nothing_observes_stay_where_they_are():
    points, observations = seen_points(60, np.random.default_rng(6), 0.1)
    kept = (observations.camera != 8) & (observations.block != 7)
    columns = (observations.camera, observations.block, observations.pixels, observations.sd_px)
    observations = Observations(*(column[kept] for column in columns))
    problem = posed_problem(observations, TRUE)
    found = adjust(problem, started(problem, TRUE, points), 20)
    np.testing.assert_allclose(found.cameras.centers[8], TRUE.centers[8], atol=1e-6)
    assert isinstance(found.blocks, ScenePoints)
    np.testing.assert_allclose(found.blocks.positions[7], points[7], atol=1e-9)


def test_no_step_raises_the_cost():
    points, observations = seen_points(80, np.random.default_rng(7), 0.2)
    nominal = Cameras.of(misplaced(RIG, 5, 1).cameras)
    problem = posed_problem(observations, nominal, Loss("cauchy", 30.0))
    start = started(problem, nominal, points + 1.5 * np.array([0, 0, -1.0]))  # some of it behind the cameras
    costs = [cost(problem, adjust(problem, start, n, 0.0)) for n in range(6)]
    assert costs == sorted(costs, reverse=True)
    assert np.isfinite(costs).all()


def test_nothing_free_changes_nothing():
    points, observations = seen_points(30, np.random.default_rng(8), 0.0)
    problem = Problem(observations, Freedom.none(VIEWS), Loss())
    found = adjust(problem, State(TRUE, ScenePoints(points + 0.05), np.zeros(0)), 50, 1e-14)
    np.testing.assert_array_equal(found.cameras.centers, TRUE.centers)
    assert isinstance(found.blocks, ScenePoints)
    several = np.bincount(observations.block, minlength=30) > 2
    np.testing.assert_allclose(found.blocks.positions[several], points[several], atol=1e-6)
