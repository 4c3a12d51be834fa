"""Depths beyond the usual range: found where something is there, not looked for elsewhere, an even sky put far."""

import numpy as np
import pytest
import torch

from acquisition.scenes.catalog import build_scene
from reconstruction.initialization.beyond import SHELL, endless, is_open, searched, with_sky
from reconstruction.initialization.points import Points, Seeds
from reconstruction.initialization.seeding import LARGEST_M, seed_cloud
from reconstruction.initialization.sweep import DepthMap, SweepOptions, depth_range_m
from reconstruction.pipeline.points_stage import swept_maps
from reconstruction.scene_model import TimeSpan
from reconstruction.training.trainer import extent_m
from rigs.toml import catalog_rig

RIG = catalog_rig("lab3x3").scaled(160, 100)
USUAL = SweepOptions(*depth_range_m(RIG.cameras))


def seen(name):
    """Return what every camera of the rig sees of a scene, and how far it is."""
    frames = [build_scene(name, 1).render(camera, np.array([0.0]), 3) for camera in RIG.cameras]
    return [f.intensity[0] for f in frames], [f.depth[0] for f in frames]


@pytest.mark.parametrize("name", ["fan_and_ball", "black", "static"])
def test_a_scene_without_anything_far_is_searched_as_ever(name):
    assert searched(RIG.cameras, seen(name)[0], USUAL) == USUAL


def test_hills_are_found_where_they_are():
    images, depths = seen("far")
    options = searched(RIG.cameras, images, USUAL)
    assert is_open(options, USUAL)
    steps = [np.diff(o.inverse_depths)[0] for o in (options, USUAL)]
    assert steps[0] == pytest.approx(steps[1], rel=0.01)
    hills = depths[4] > 30
    shares, errors = [], []
    for chosen in (options, USUAL):
        found = swept_maps(RIG.cameras, images, chosen)[4].depth
        shares.append(np.isfinite(found[hills]).mean())
        errors.append(np.nanmedian(np.abs(1 / found[hills] - 1 / depths[4][hills])) * USUAL.far_m)
    assert shares[0] > 0.6
    assert shares[0] > 2 * shares[1]  # measured 0.73 and 0.33
    assert errors[0] < 0.1  # of the usual farthest inverse depth
    assert errors[1] > 0.5


def test_an_even_sky_is_put_far_and_textured_gaps_are_not():
    depth = np.full((40, 60), np.nan, np.float32)
    depth[25:, 30:] = 2.0
    depth[:10, :10] = 3.0
    texture = np.zeros((40, 60), bool)
    texture[20:] = True
    image = np.full((40, 60), 0.4, np.float32)
    found = with_sky(DepthMap(RIG.cameras[0], depth, depth), image, texture, USUAL).depth
    assert (found[:10, :10] == 3.0).all()
    assert (found[25:, 30:] == 2.0).all()
    np.testing.assert_allclose(found[:20, 15:], SHELL * USUAL.far_m, rtol=1e-6)
    assert np.isnan(found[25:, :30]).all()
    nothing = DepthMap(RIG.cameras[0], np.full_like(depth, np.nan), depth)
    slope = image * np.linspace(0.5, 1, 60, dtype=np.float32)
    assert np.isnan(with_sky(nothing, slope, texture, USUAL).depth).all()
    texture[:, 4:] = True  # what is left is too small
    assert np.isnan(with_sky(nothing, image, texture, USUAL).depth).all()


def test_endless_depths_are_a_step_from_infinity():
    options = endless(USUAL)
    assert options.inverse_depths[0] < np.diff(options.inverse_depths)[0]
    assert options.inverse_depths[-1] == pytest.approx(USUAL.inverse_depths[-1])


def far_points(distance_m):
    positions = np.array([[0.0, 0, 2], [1, 0, 2], [0, 10, distance_m], [30, 0, distance_m]])
    return Points(positions, np.full(4, 0.3, np.float32), np.full(4, 50.0), np.zeros(4))


def test_far_gaussians_may_be_larger_and_do_not_stretch_the_unit_of_what_is_learnt():
    clip = TimeSpan(0.0, 0.02)
    near, far = (
        seed_cloud(Seeds(far_points(d), Points.none(), clip, 8, 0, RIG.cameras, lambda: None)) for d in (2.0, 200.0)
    )
    sizes = torch.exp(far.still.log_scales[:, 0])
    assert sizes[:2].tolist() == pytest.approx([LARGEST_M] * 2)
    assert sizes[2:].tolist() == pytest.approx([LARGEST_M * 200 / USUAL.far_m] * 2, rel=0.05)
    assert extent_m(near, RIG.cameras) == pytest.approx(4.1, abs=3)
    assert extent_m(far, RIG.cameras) == pytest.approx(2.1, abs=0.2)
