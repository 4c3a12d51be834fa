import math

import numpy as np
import pytest
import torch

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.rendering.result import Rendering
from reconstruction.scene_model import TimeSpan
from reconstruction.training.exposure import FAR_PX, FROM, Exposure, mean_of, passed_px
from rigs.camera import Camera
from rigs.clock import RigClock
from rigs.transform import Transform

WIDTH, HEIGHT, PLANES, RATE_HZ = 72, 56, 64, 20_000.0
CLOCK, CLIP = RigClock(RATE_HZ), TimeSpan(0.0, PLANES / RATE_HZ)
CAMERA = Camera("cam00", WIDTH, HEIGHT, 60.0, 60.0, WIDTH / 2, HEIGHT / 2, Transform.identity())
NINE_S = 9 / RATE_HZ


def blobs(speeds: list[float], depth_m: float = 1.5) -> DynamicCloud:
    """One bright blob for each speed (m a clip, sideways), all in the middle of the picture at half the clip."""
    count = len(speeds)
    place = torch.tensor([[0.0, 0.0, depth_m]])
    still = GaussianCloud.from_points(place, torch.zeros(1, 1), torch.full((1,), 0.01).log(), 0.01)
    moving = GaussianCloud.from_points(
        place.expand(count, 3).clone(), torch.full((count, 1), 0.5), torch.full((count,), 0.12).log(), 0.95
    )
    motion = PolynomialMotion.at_rest(torch.full((count,), 0.5), 100.0)
    motion.velocities[:, 0] = torch.tensor(speeds)
    return DynamicCloud(still, moving, motion, CLIP)


@pytest.mark.parametrize("speed", [1e-6, 0.05, 0.8, 4.0])
def test_how_far_a_mover_gets_is_its_speed_in_the_picture(speed):
    expected = 60 / 1.5 * speed * 9 / PLANES
    assert passed_px(blobs([speed]), [CAMERA, CAMERA], NINE_S) == pytest.approx(expected, rel=2e-2, abs=1e-5)


def test_a_tenth_may_be_faster():
    assert passed_px(blobs([0.1] * 10 + [3.0]), [CAMERA], NINE_S) == pytest.approx(
        60 / 1.5 * 0.1 * 9 / PLANES, rel=2e-2
    )
    assert passed_px(blobs([0.1] * 2 + [3.0]), [CAMERA], NINE_S) > FAR_PX


def gone(cloud: DynamicCloud) -> DynamicCloud:
    cloud.moving.opacity_logits[:] = -20.0
    return cloud


@pytest.mark.parametrize(
    "cloud",
    [
        pytest.param(blobs([]), id="none"),
        pytest.param(blobs([3.0], depth_m=-1.5), id="behind"),
        pytest.param(blobs([3.0], depth_m=0.0), id="in the camera"),
        pytest.param(blobs([1e30]), id="out of the picture"),
        pytest.param(blobs([float("nan")]), id="nan"),
        pytest.param(gone(blobs([3.0])), id="transparent"),
    ],
)
def test_what_no_camera_sees_moving_does_not_count(cloud):
    assert passed_px(cloud, [CAMERA], NINE_S) == 0.0


def test_one_instant_stands_for_an_image_until_fast_movers_are_seen_late_enough():
    exposure, fast = Exposure(9, CLOCK), blobs([3.0])
    exposure.look(fast, [CAMERA], FROM - 0.01)
    assert (exposure.passed_px, exposure.nodes) == (None, 1)
    exposure.look(fast, [CAMERA], FROM)
    found = exposure.nodes
    assert found > 1
    exposure.look(blobs([0.0]), [CAMERA], 0.9)  # looked at once
    assert exposure.nodes == found
    slow = Exposure(9, CLOCK)
    slow.look(blobs([0.1]), [CAMERA], FROM)
    assert slow.nodes == 1


@pytest.mark.parametrize(
    ("passed_px", "nodes"),
    [(0.0, 1), (0.79, 1), (0.8, 2), (8.0, 2), (8.01, 3), (31.9, 8), (33.0, 8), (1e300, 8), (math.inf, 8)],
)
def test_longer_ways_take_more_instants_up_to_a_limit(passed_px, nodes):
    exposure = Exposure(99, CLOCK)
    exposure.passed_px = passed_px
    assert exposure.nodes == nodes


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_mean_of_renders_and_its_gradient_are_those_of_the_weights(dtype):
    rng = np.random.default_rng(0)
    leaves = [torch.tensor(rng.uniform(0, 1, (5, 7)), dtype=dtype, requires_grad=True) for _ in range(6)]
    renders = [
        (weight, Rendering(light[..., None], depth, alpha, torch.zeros(3, dtype=torch.int32), median=depth))
        for weight, light, depth, alpha in ((0.25, *leaves[:3]), (0.75, *leaves[3:]))
    ]
    mean = mean_of(renders)
    for name, one, two in zip(("intensity", "depth", "alpha"), leaves[:3], leaves[3:], strict=True):
        expected = 0.25 * one.detach().double() + 0.75 * two.detach().double()
        assert np.allclose(getattr(mean, name).detach().reshape(5, 7), expected, rtol=1e-6)
    assert mean.median is None
    (mean.intensity.sum() + 2 * mean.depth.sum() + 3 * mean.alpha.sum()).backward()
    for slope, leaf in zip((0.25, 0.5, 0.75, 0.75, 1.5, 2.25), leaves, strict=True):
        assert leaf.grad is not None
        assert np.allclose(leaf.grad, slope)
    assert mean_of(renders[:1]) is renders[0][1]
