"""Depths beyond the usual range: found where something is there, not looked for elsewhere, an even sky put far."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from acquisition.scenes.catalog import build_scene
from acquisition.spikes.sensor import DARK_LEVEL
from reconstruction.initialization.beyond import SHELL, empty, endless, is_open, searched, sky, with_sky
from reconstruction.initialization.points import Points, Seeds
from reconstruction.initialization.pyramid import swept_maps
from reconstruction.initialization.seeding import LARGEST_M, seed_cloud
from reconstruction.initialization.sweep import DepthMap, SweepOptions, depth_range_m
from reconstruction.rendering.result import Rendering
from reconstruction.scene_model import TimeSpan
from reconstruction.training.image_term import ImageTerm
from reconstruction.training.trainer import extent_m
from reconstruction.training.view import TrainingView
from rigs.clock import RigClock
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


def test_a_bright_even_border_is_sky_and_nothing_else_is():
    image, texture = np.full((40, 60), 0.2, np.float32), np.zeros((40, 60), bool)
    image[:20], texture[20:] = 0.4, True
    image[25:35, 20:40], texture[25:35, 20:40] = 0.5, False  # bright and even, but inside
    expected = np.zeros((40, 60), bool)
    expected[:20] = True
    np.testing.assert_array_equal(sky(image, texture), expected)
    slope = image * np.linspace(0.5, 1, 60, dtype=np.float32)
    assert not sky(slope, texture).any()
    assert not sky(1 - image, texture).any()  # darker than most
    texture[:, 4:] = True  # what is left is too small
    assert not sky(image, texture).any()


def test_the_sky_is_put_far_and_the_rest_stays():
    image, texture = np.full((40, 60), 0.2, np.float32), np.zeros((40, 60), bool)
    image[:20], texture[20:] = 0.4, True
    depth = np.full((40, 60), np.nan, np.float32)
    depth[5:, :] = 2.0  # below row 20 confirmed, above it by chance
    (found,), (known,) = with_sky([DepthMap(RIG.cameras[0], depth, depth)], [image], [texture], USUAL)
    np.testing.assert_allclose(found.depth[:20], SHELL * USUAL.far_m)
    assert (found.depth[20:] == 2.0).all()
    assert known.all()
    depth[30:, :] = 100.0
    (found,), _ = with_sky([DepthMap(RIG.cameras[0], depth, depth)], [image], [texture], USUAL)
    np.testing.assert_allclose(found.depth[:20], 100.0)


def test_nothing_is_where_a_large_area_has_neither_light_nor_texture():
    image, texture = np.full((40, 60), 0.3, np.float32), np.ones((40, 60), bool)
    image[:20], texture[:20] = DARK_LEVEL, False
    image[30:33, 5:9], texture[30:33, 5:9] = 0.0, False  # small
    found = empty(image, texture, 0.5)
    assert found[:20].all()
    assert not found[20:].any()
    assert not empty(image, np.ones_like(texture), 0.5).any()
    assert not empty(np.minimum(image, 0.004), texture, 0.004).any()  # so dim that darkness tells nothing


def test_light_may_pass_where_nothing_is_and_nothing_may_stop_it():
    term = ImageTerm(RigClock(20000.0), 0.6, solid=0.5)
    target, alpha = torch.zeros(16, 16), torch.full((16, 16), 0.25, requires_grad=True)
    rendered = Rendering(torch.zeros(16, 16, 1), torch.ones(16, 16), alpha, torch.zeros(0))
    half = torch.zeros(16, 16)
    half[:8] = 1
    straight = SimpleNamespace(straightening=None)
    view = TrainingView(RIG.cameras[0], straight)  # pyright: ignore[reportArgumentType]
    losses = [term.held(replace(view, empty=e), rendered, target) for e in (None, half)]
    assert losses[0].item() == pytest.approx(0.5 * 0.75)
    assert losses[1].item() == pytest.approx(0.5 * (0.25 * 0.5 + 0.75 * 0.5))
    (slope,) = torch.autograd.grad(losses[1], alpha)
    torch.testing.assert_close(slope, 0.5 / 256 * (2 * half - 1))


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
