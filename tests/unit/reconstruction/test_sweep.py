import os
import pickle
import subprocess
import sys

import cv2
import numpy as np
import pytest
from references.stereo import confirmations_reference, sweep_around_reference, sweep_view_reference

from reconstruction.initialization.points import Points, sample_points, spacing
from reconstruction.initialization.sweep import (
    DepthMap,
    SweepOptions,
    back_project,
    back_projected,
    confirmations,
    consistent,
    depth_range_m,
    neighbours,
    sweep_around,
    sweep_view,
)
from rigs.camera import Camera
from rigs.transform import Transform

W, H = 96, 64
SWEEPS = (sweep_view, sweep_view_reference)


def texture(seed=0, size=512):
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.random((size, size)).astype(np.float32), (0, 0), 1.5)
    return (noise - noise.min()) / np.ptp(noise) * 0.6


def camera_at(x, y, target=(0, 0, 2.0)):
    pose = Transform.looking_at((x, y, 0.0), target)
    return Camera("view", W, H, 90.0, 90.0, W / 2, H / 2, pose)


def see_plane(camera, normal, offset, pattern):
    """Image and depth of the textured plane normal . x = offset, by casting each pixel's centre ray."""
    x, y = np.meshgrid(
        (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx,
        (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy,
    )
    rays = np.stack([x, y, np.ones_like(x)], -1) @ camera.cam_from_rig.rotation
    depth = (offset - camera.center @ normal) / (rays @ normal)
    points = camera.center + rays * depth[..., None]
    u, v = (points[..., 0] * 90 + 256).astype(np.float32), (points[..., 1] * 90 + 256).astype(np.float32)
    return cv2.remap(pattern, u, v, cv2.INTER_CUBIC), depth.astype(np.float32)


@pytest.fixture(scope="module")
def scene():
    normal = np.array([0.2, -0.1, 1.0])
    cameras = [camera_at(x, y) for y in (-0.2, 0, 0.2) for x in (-0.2, 0, 0.2)]
    seen = [see_plane(c, normal, 2.0, texture()) for c in cameras]
    return cameras, [image for image, _ in seen], [depth for _, depth in seen]


def test_a_slanted_plane_is_found_within_a_hundredth(scene):
    cameras, images, depths = scene
    options = SweepOptions(*depth_range_m(cameras), planes=96)
    maps = []
    for i, camera in enumerate(cameras):
        others = [(c, images[j]) for j, c in enumerate(cameras) if j != i]
        near = [others[j] for j in neighbours(camera, [c for c, _ in others])]
        maps.append(sweep_view((camera, images[i]), near, options))
    checked = consistent(maps, options)
    for found, truth in zip(checked, depths, strict=True):
        known = np.isfinite(found.depth)
        assert known.mean() > 0.6
        assert np.median(np.abs(found.depth[known] / truth[known] - 1)) < 0.01


@pytest.mark.parametrize("radius", [2, 3])
def test_the_kernel_finds_what_its_twin_finds(scene, radius):
    cameras, images, _ = scene
    views = list(zip(cameras, images, strict=True))
    options = SweepOptions(*depth_range_m(cameras), planes=24, radius_px=radius)
    found, twin = (sweep(views[4], [views[i] for i in (1, 3, 5, 8)], options) for sweep in SWEEPS)
    assert np.abs(found.cost - twin.cost).max() < 2e-4  # a step is 1.07e-4
    assert (np.abs(found.depth / twin.depth - 1) > 1e-3).mean() < 1e-3


@pytest.mark.parametrize("planes", [3, 9])
@pytest.mark.parametrize("radius", [1, 2, 3])
def test_the_sweep_around_depths_finds_what_its_twin_finds(scene, radius, planes):
    cameras, images, depths = scene
    views = list(zip(cameras, images, strict=True))
    options = SweepOptions(*depth_range_m(cameras), radius_px=radius)
    step = np.diff(options.inverse_depths[:2])[0]
    rough = (1 / depths[4] + step * np.sin(np.arange(W) / 9)).astype(np.float32)
    rough[:, 60:] = rough[:, 20:56]  # wrong behind an edge
    rough[:4], rough[4:8] = 0, 100  # out of the range
    steps = (np.arange(planes) - planes // 2) * step / 2
    near = [views[i] for i in (1, 3, 5, 8)]
    found, twin = (s(views[4], near, options, rough, steps) for s in (sweep_around, sweep_around_reference))
    assert (np.abs(found.cost - twin.cost) > 2e-4).mean() < 2e-3  # a step is 1.07e-4; another depth has another cost
    assert (np.abs(found.depth / twin.depth - 1) > 1e-3).mean() < 2e-3
    right = np.s_[12:-4, 4:56]
    assert np.median(np.abs(found.depth / depths[4] - 1)[right]) < 0.005
    for threads in (1, 3):
        assert (sweep_around(views[4], near, options, rough, steps, threads=threads).depth == found.depth).all()


def test_the_sweep_does_not_depend_on_the_number_of_threads(scene):
    cameras, images, _ = scene
    views = list(zip(cameras, images, strict=True))
    options = SweepOptions(*depth_range_m(cameras), planes=24)
    threes = [sweep_view(views[4], views[:4], options, threads=threads).depth for threads in (1, 3)]
    assert (threes[0] == threes[1]).all()
    run = (
        "import os, sys, pickle; views, options = pickle.load(sys.stdin.buffer);"
        "from reconstruction.initialization.sweep import sweep_view;"
        "sys.stdout.buffer.write(sweep_view(views[4], views[:4], options).depth.tobytes())"
    )
    depths = [
        subprocess.run(
            [sys.executable, "-c", run],
            input=pickle.dumps((views, options)),
            env=os.environ | {"OMP_NUM_THREADS": threads},
            capture_output=True,
            check=True,
        ).stdout
        for threads in ("1", "3")
    ]
    assert len(depths[0]) == W * H * 4
    assert depths[0] == depths[1]


def test_noise_without_a_surface_finds_no_consistent_depth(scene):
    cameras, *_ = scene
    rng = np.random.default_rng(3)
    images = [rng.random((H, W)).astype(np.float32) for _ in cameras]
    options = SweepOptions(*depth_range_m(cameras), planes=96)
    views = list(zip(cameras, images, strict=True))
    maps = [sweep_view(v, [o for o in views if o is not v][:4], options) for v in views]
    assert np.mean([np.isfinite(m.depth).mean() for m in consistent(maps, options)]) < 0.2


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_flat_images_give_finite_depths_and_full_cost(scene, value):
    cameras, *_ = scene
    image = np.full((H, W), value, np.float32)
    found = sweep_view((cameras[4], image), [(cameras[3], image), (cameras[5], image)], SweepOptions(1, 8, planes=16))
    assert np.isfinite(found.depth).all()
    assert np.abs(found.cost - 1).max() < 1e-3


@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 5), (17, 23)])
def test_tiny_images_do_not_break_the_sweep(height, width):
    rng = np.random.default_rng(0)
    left = Camera("a", width, height, 20.0, 20.0, width / 2, height / 2, Transform.looking_at((0, 0, 0), (0, 0, 2)))
    right = Camera("b", width, height, 20.0, 20.0, width / 2, height / 2, Transform.looking_at((0.1, 0, 0), (0, 0, 2)))
    images = rng.random((2, height, width)).astype(np.float32)
    found = sweep_view((left, images[0]), [(right, images[1])], SweepOptions(1, 4, planes=8))
    assert found.depth.shape == (height, width)
    assert (found.depth > 0).all()


def test_the_range_brackets_where_the_axes_meet():
    near, far = depth_range_m([camera_at(x, 0, (0, 0, 1.8)) for x in (-0.2, 0, 0.2)])
    assert near == pytest.approx(0.9, rel=0.02)
    assert far == pytest.approx(7.2, rel=0.02)


def test_parallel_cameras_still_get_a_range():
    near, far = depth_range_m([camera_at(x, 0, (x, 0, 1)) for x in (-0.2, 0, 0.2)])
    assert 0 < near < 1.4 < far


def test_back_projection_inverts_projection():
    camera = camera_at(0.2, -0.1)
    depth = np.full((H, W), 1.7, np.float32)
    points = camera.cam_from_rig.apply(back_project(camera, depth))
    assert np.allclose(points[..., 2], 1.7)
    assert np.allclose(points[10, 20, 0] / 1.7 * camera.fx + camera.cx, 20.5)


def test_single_pixels_are_projected_back_as_the_whole_view(scene):
    cameras, _, depths = scene
    pixels = np.array([0, W - 1, 5 * W + 7, H * W - 1, 5 * W + 7])
    whole = back_project(cameras[2], depths[2]).reshape(-1, 3)
    found = back_projected(DepthMap(cameras[2], depths[2], depths[2]), pixels)
    np.testing.assert_allclose(found, whole[pixels], rtol=1e-12)
    assert back_projected(DepthMap(cameras[2], depths[2], depths[2]), pixels[:0]).shape == (0, 3)


def test_sampled_points_lie_on_the_surface_and_respect_the_mask(scene):
    cameras, images, depths = scene
    maps = [DepthMap(c, d, np.zeros_like(d)) for c, d in zip(cameras, depths, strict=True)]
    masks = [np.zeros((H, W), bool) for _ in cameras]
    masks[4][:, : W // 2] = True
    points = sample_points(maps, images, masks, 50, 0.01, np.random.default_rng(0))
    assert len(points) == 50
    assert np.abs(points.positions @ [0.2, -0.1, 1.0] - 2.0).max() < 1e-5
    assert (cameras[4].cam_from_rig.apply(points.positions)[:, 0] < 0).all()
    assert (points.instants_s == 0.01).all()


def test_no_wanted_pixels_give_no_points(scene):
    cameras, images, depths = scene
    maps = [DepthMap(c, d, np.zeros_like(d)) for c, d in zip(cameras, depths, strict=True)]
    assert len(sample_points(maps, images, [np.zeros((H, W), bool)] * 9, 50, 0.0, np.random.default_rng(0))) == 0
    assert len(Points.joined([])) == 0


def test_spacing_of_a_grid_is_its_pitch_and_of_one_point_a_centimetre():
    grid = np.stack(np.meshgrid(np.arange(6), np.arange(6), [0.0]), -1).reshape(-1, 3) * 0.1
    assert np.allclose(spacing(grid)[[7, 8, 14]], 0.1, atol=1e-6)
    assert spacing(grid[:1]).tolist() == [0.01]


def test_spacing_is_that_of_all_distances_also_far_from_the_origin():
    points = np.random.default_rng(1).normal(size=(600, 3)) * 0.3 + [0, 0, 50.0]
    points[:40] = points[40:80]  # twins have one neighbour at no distance
    apart = np.sort(np.linalg.norm(points[:, None] - points, axis=-1), axis=1)[:, 1:4].mean(axis=1)
    assert np.abs(spacing(points) / apart - 1).max() < 2e-5


def test_confirmations_are_those_of_the_twin(scene):
    cameras, _, depths = scene
    rng = np.random.default_rng(2)
    blurred = [(d * (1 + 0.02 * rng.normal(size=d.shape))).astype(np.float32) for d in depths]
    for depth in blurred:
        depth[rng.random(depth.shape) < 0.1] = np.nan
    small = DepthMap(cameras[5].scaled(W // 2, H // 2), blurred[5][::2, ::2], blurred[5][::2, ::2])
    maps = [*(DepthMap(c, d, d) for c, d in zip(cameras[:5], blurred[:5], strict=True)), small]
    votes = confirmations(maps[4], [*maps[:4], small], 0.01)
    assert set(np.unique(votes)) == {0, 1, 2, 3, 4, 5}
    assert (votes == confirmations_reference(maps[4], [*maps[:4], small], 0.01)).all()
