"""Corrections of cameras learnt in training: the same as moving the camera, differentiable, without a drift."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.rendering.render import render
from reconstruction.scene_model import TimeSpan
from reconstruction.training.refinement import Refinement
from rigs.rig import Rig
from rigs.toml import catalog_rig

RIG = catalog_rig("ci3x3").scaled(60, 40)
TICK_S = 1 / 20000


def random_cloud(n, rng):
    return GaussianCloud(
        torch.from_numpy(rng.uniform((-0.4, -0.3, 1.5), (0.4, 0.3, 2.2), (n, 3)).astype(np.float32)),
        torch.from_numpy(rng.normal(size=(n, 4)).astype(np.float32)),
        torch.from_numpy(np.log(rng.uniform(0.02, 0.08, (n, 3))).astype(np.float32)),
        torch.full((n,), 2.0),
        torch.from_numpy(rng.uniform(0.1, 0.6, (n, 1)).astype(np.float32)),
    )


@pytest.fixture
def cloud():
    rng = np.random.default_rng(0)
    moving, count = random_cloud(20, rng), 20
    motion = PolynomialMotion.at_rest(torch.full((count,), 0.5), 1.0)
    motion.velocities += torch.from_numpy(rng.normal(0, 0.3, (count, 3)).astype(np.float32))
    return DynamicCloud(random_cloud(60, rng), moving, motion, TimeSpan(0.0, 0.02))


def refinement(rig: Rig = RIG) -> Refinement:
    return Refinement(rig.cameras, 1.8, TICK_S)


def test_nothing_learnt_changes_nothing(cloud):
    for now, plain in zip(refinement().seen(cloud, 0.004, 3), cloud.at(0.004), strict=True):
        torch.testing.assert_close(now, plain, rtol=1e-6, atol=1e-6)


def test_a_correction_shows_what_the_corrected_camera_sees(cloud):
    found = refinement()
    with torch.no_grad():
        found.turns[3] = torch.tensor([0.01, -0.02, 0.015])
        found.shifts[3] = torch.tensor([0.004, 0.002, -0.003])
        found.log_gains[3] = 0.1
    corrected = found.refined(RIG).cameras[3]
    assert np.linalg.norm(corrected.center - RIG.cameras[3].center) == pytest.approx(1.8 * 0.00539, rel=1e-2)
    with torch.no_grad():
        shown = render(found.seen(cloud, 0.004, 3), RIG.cameras[3]).intensity
        seen = render(cloud.at(0.004), corrected).intensity * float(np.exp(0.1))
    torch.testing.assert_close(shown, seen, rtol=1e-4, atol=1e-4)


def test_a_lag_is_a_later_instant(cloud):
    found = refinement()
    with torch.no_grad():
        found.lags[2] = 3.0
    torch.testing.assert_close(found.seen(cloud, 0.004, 2).means, cloud.at(0.004 + 3 * TICK_S).means, atol=1e-5, rtol=0)


def test_gradients_are_those_of_finite_differences(cloud):
    found, rng = refinement(), np.random.default_rng(1)
    weights = torch.from_numpy(rng.normal(size=(80, 3)).astype(np.float32))

    def value():
        return (found.seen(cloud, 0.004, 1).means * weights).sum()

    value().backward()
    for name in ("turns", "shifts"):
        for axis in range(3):
            values = []
            for sign in (1, -1):
                with torch.no_grad():
                    getattr(found, name)[1, axis] += sign * 1e-2
                    values.append(float(value()))
                    getattr(found, name)[1, axis] -= sign * 1e-2
            assert float(getattr(found, name).grad[1, axis]) == pytest.approx((values[0] - values[1]) / 2e-2, rel=0.02)


def test_steps_do_not_move_turn_scale_brighten_or_delay_everything():
    found, rng = refinement(), torch.Generator().manual_seed(0)
    for _ in range(5):
        for name in ("turns", "shifts", "log_gains", "lags"):
            tensor = getattr(found, name)
            tensor.grad = torch.randn(tensor.shape, generator=rng) + 1.0
        found.step(0.3)
    in_rig = torch.stack(
        [torch.from_numpy(c.cam_from_rig.rotation.T).float() @ t for c, t in zip(RIG.cameras, found.turns, strict=True)]
    )
    for drift in (in_rig.mean(dim=0), found.shifts.mean(dim=0), found.log_gains.mean(), found.lags.mean()):
        assert float(drift.detach().abs().max()) < 1e-7
    assert float(found.turns.detach().abs().max()) > 1e-4


def test_it_learns_where_a_camera_looks(cloud):
    found = refinement()
    turned = replace(RIG.cameras[4], cam_from_rig=RIG.cameras[4].cam_from_rig)
    with torch.no_grad():
        found.turns[4] = torch.tensor([0.004, -0.003, 0.0])
        wanted = render(found.seen(cloud, 0.004, 4), turned).intensity
        found.turns[4] = 0.0
    losses = []
    for step in range(60):
        loss = (render(found.seen(cloud, 0.004, 4), turned).intensity - wanted).abs().mean()
        loss.backward()
        losses.append(float(loss.detach()))
        found.step(step / 60)
    assert losses[-1] < 0.4 * losses[0]


def test_state_carries_over(cloud):
    one, other = refinement(), refinement()
    one.turns.grad = torch.ones_like(one.turns) * torch.arange(9)[:, None]
    one.step(0.1)
    other.restore(one.state())
    torch.testing.assert_close(one.turns, other.turns)
    for found in (one, other):
        found.turns.grad = torch.ones_like(found.turns) * torch.arange(9)[:, None]
        found.step(0.2)
    torch.testing.assert_close(one.turns, other.turns, rtol=0, atol=0)
    assert set(one.report()) == set(RIG.ids)
