import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from reconstruction.errors import ReconstructionError
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.initialization.points import Points, Seeds
from reconstruction.initialization.seeding import LIFE, seed_cloud
from reconstruction.rendering.result import GUARDS
from reconstruction.scene_model import TimeSpan

CLIP = TimeSpan(0.0, 0.02)


def points(count, instant_s=0.01, seed=0):
    rng = np.random.default_rng(seed)
    return Points(
        rng.normal(size=(count, 3)),
        rng.random(count).astype(np.float32),
        np.full(count, 0.02),
        np.full(count, instant_s),
    )


def seeds(still, moving, instants):
    return Seeds(still, moving, CLIP, instants, 0, (), lambda: None)


def test_a_moving_gaussian_is_where_its_velocity_takes_it_and_fades_with_its_gate():
    cloud = seed_cloud(seeds(points(3), points(2, instant_s=0.01), 8))
    cloud.motion.velocities[:] = torch.tensor([1.0, 2.0, 3.0])
    at_birth, later = cloud.at(0.01), cloud.at(0.0125)  # 0 and 1/8 clip after its instant
    assert torch.allclose(later.means[3:] - at_birth.means[3:], torch.tensor([0.125, 0.25, 0.375]), atol=1e-6)
    duration = LIFE / 8
    expected = math.exp(-0.5 * (0.125 / duration) ** 2)
    assert torch.allclose(later.opacities[3:] / at_birth.opacities[3:], torch.full((2,), expected), rtol=1e-4)


@pytest.mark.parametrize("cubic", [False, True])
def test_what_rests_among_movers_is_there_all_the_time(cubic):
    cloud = seed_cloud(replace(seeds(points(1), points(3, instant_s=0.0), 8), resting=2), cubic=cubic)
    first, last = (cloud.at(t).opacities[1:] for t in (0.0, 0.02))
    assert (first > 0.5).all()
    assert (last[1:] > 0.5).all()
    assert last[0] < 1e-6


def test_still_gaussians_do_not_depend_on_time():
    cloud = seed_cloud(seeds(points(4), points(2), 8))
    first, last = cloud.at(0.0), cloud.at(0.02)
    for a, b in zip(first, last, strict=True):
        assert torch.equal(a[:4], b[:4])


@pytest.mark.parametrize("log_duration", [-100.0, 100.0])
def test_durations_are_floored_and_become_static(log_duration):
    cloud = seed_cloud(seeds(points(0), points(2, instant_s=0.01), 8))
    cloud.motion.log_durations[:] = log_duration
    cloud.motion.log_durations.requires_grad_(True)
    opacities = cloud.at(0.02).opacities
    opacities.sum().backward()
    assert torch.isfinite(opacities).all()
    assert torch.isfinite(cloud.motion.log_durations.grad).all()
    expected = 0.0 if log_duration < 0 else 0.6
    assert torch.allclose(opacities, torch.full((2,), expected), atol=1e-6)


@pytest.mark.parametrize("instant_s", [-1e6, 1e6])
def test_far_from_its_instant_a_gaussian_is_gone_and_finite(instant_s):
    cloud = seed_cloud(seeds(points(1), points(2), 8))
    cloud.motion.velocities[:] = 5.0
    now = cloud.at(instant_s)
    assert torch.isfinite(now.means).all()
    assert (now.opacities[1:] == 0).all()


def test_state_round_trips():
    cloud = seed_cloud(seeds(points(3), points(5), 4))
    back = DynamicCloud.from_state(cloud.state())
    assert back.clip == cloud.clip
    assert back.dilation_px2 == cloud.dilation_px2 == GUARDS.dilation_px2
    for (name, a), (other, b) in zip(cloud.tensors(), back.tensors(), strict=True):
        assert name == other
        assert torch.equal(a, b)


def test_a_clip_without_length_is_refused():
    with pytest.raises(ReconstructionError, match="expected a positive length"):
        TimeSpan(0.01, 0.01)
