"""Timestep by timestep: what each learns, what lies between, and the losses that hold neighbours together."""

import math

import numpy as np
import pytest
import torch

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.rigidity import ISOMETRY, RIGID, ROTATION, neighbourhood, rigidity, weights_of
from reconstruction.gaussians.timesteps import FIRST, TIMESTEPS, TimestepMotion
from reconstruction.quaternions import matrices, product, rotated, unit

STEPS = TIMESTEPS - 1


def cloud_of(n: int, dtype=torch.float64) -> GaussianCloud:
    generator = torch.Generator().manual_seed(n)
    draw = lambda *shape: torch.randn(*shape, generator=generator, dtype=dtype)  # noqa: E731
    return GaussianCloud(draw(n, 3), draw(n, 4), draw(n, 3), draw(n), draw(n, 1))


def due(timestep: float) -> float:
    """The share of the training at which a timestep from 1 on has just begun."""
    return FIRST + (1 - FIRST) * (timestep - 1 + 1e-9) / STEPS


def moved(n: int) -> tuple[GaussianCloud, TimestepMotion, list[torch.Tensor], list[torch.Tensor]]:
    """A cloud at its fourth timestep, and the means and unit quaternions of all four."""
    cloud = cloud_of(n)
    motion, means, quats = TimestepMotion.started(cloud.means), [], []
    for k in range(4):
        if k:
            motion.advance(cloud, due(k))
        cloud.means += 0.1 * torch.sin(torch.arange(3 * n).reshape(n, 3) + k)
        cloud.quats_wxyz += 0.2
        means.append(cloud.means.clone())
        quats.append(unit(cloud.quats_wxyz))
    return cloud, motion, means, quats


def test_between_timesteps_it_is_linear_and_after_the_newest_it_stands():
    cloud, motion, means, quats = moved(5)
    for place, left, share in ((0.0, 0, 0.0), (0.25, 0, 0.25), (1.5, 1, 0.5), (2.75, 2, 0.75), (3.0, 3, 0.0)):
        now, right = motion.at(cloud, place / STEPS), min(left + 1, 3)
        torch.testing.assert_close(now.means, means[left] * (1 - share) + means[right] * share)
        torch.testing.assert_close(now.quats_wxyz, quats[left] * (1 - share) + quats[right] * share)
    for u in (3.2 / STEPS, 1.0, 1e6):
        assert torch.equal(motion.at(cloud, u).means, means[3])
    assert torch.equal(motion.at(cloud, -1e6).means, means[0])


def test_a_timestep_starts_from_the_last_one_and_its_change():
    cloud, motion, means, quats = moved(5)
    motion.advance(cloud, due(4))
    torch.testing.assert_close(cloud.means, 2 * means[3] - means[2])
    torch.testing.assert_close(cloud.quats_wxyz, unit(2 * quats[3] - quats[2]))


def test_timesteps_follow_one_another_and_each_has_its_part_of_the_clip():
    cloud = cloud_of(3)
    motion = TimestepMotion.started(cloud.means)
    assert motion.advance(cloud, FIRST / 2) == pytest.approx(0.5)
    assert motion.span() == (0.0, pytest.approx(0.5 / STEPS))
    for k in (1, 2, STEPS):  # the last one is reached at once: those between are passed on the way
        assert motion.advance(cloud, due(k + 0.5)) == pytest.approx(0.5)
        assert motion.span() == pytest.approx(((k - 1) / STEPS, k / STEPS))
    assert motion.advance(cloud, 1.0) == pytest.approx(1.0)
    assert motion.span() == pytest.approx((1 - 1 / STEPS, 1.0))


def test_the_first_timestep_learns_everything_and_later_ones_only_places_and_turns():
    cloud = cloud_of(4)
    motion = TimestepMotion.started(cloud.means)
    for learnt in (5, 2):
        leaves = [t.detach().clone().requires_grad_() for t in vars(cloud).values()]
        now = motion.at(GaussianCloud(*leaves), 1.0)
        sum(t.square().sum() for t in now).backward()
        assert [leaf.grad is not None for leaf in leaves] == [i < learnt for i in range(5)]
        motion.advance(cloud, due(1))


@pytest.mark.parametrize("n", [3, 30])
def test_gradients_agree_with_numerical_ones(n):
    cloud, motion, _, _ = moved(n)
    leaves = [cloud.means.requires_grad_(), cloud.quats_wxyz.requires_grad_()]

    def outputs(means, quats):
        now = GaussianCloud(means, quats, cloud.log_scales, cloud.opacity_logits, cloud.intensities)
        return (*motion.at(now, 2.3 / STEPS)[:2], motion.penalty(now))

    assert torch.autograd.gradcheck(outputs, leaves, fast_mode=True)


def rigid_move(means: torch.Tensor, quats: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    turn = unit(torch.tensor([[0.9, 0.1, -0.3, 0.2]], dtype=means.dtype)).expand(len(means), 4)
    return rotated(turn, means) + torch.tensor([0.3, -2.0, 5.0], dtype=means.dtype), product(turn, quats)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 2e3])
def test_rigidity_is_zero_for_a_rigid_motion_with_no_pull_and_the_same_at_any_scale(scale):
    cloud = cloud_of(20)
    means, quats = cloud.means * scale, unit(cloud.quats_wxyz)
    near, after = neighbourhood(means), rigid_move(means, quats)
    leaves = [t.clone().requires_grad_() for t in after]
    loss = rigidity(near, (means, quats), tuple(leaves))
    loss.backward()
    assert float(loss.detach()) < 1e-9
    assert float(leaves[0].grad.abs().max()) * scale < 1e-3
    assert float(leaves[1].grad.abs().max()) < 1e-3
    bent = after[0].clone()
    bent[::2] += 0.2 * scale
    one = cloud.means * 1.0
    bent_one = rigid_move(one, quats)[0].clone()
    bent_one[::2] += 0.2
    of_one = rigidity(neighbourhood(one), (one, quats), (bent_one, after[1]))
    found = rigidity(near, (means, quats), (bent, after[1]))
    assert float(found) == pytest.approx(float(of_one), rel=1e-9)
    assert float(found) > 0.1


def test_rigidity_is_that_of_the_paper():
    """Against loops over equations 4 to 8, with rotation matrices."""
    cloud = cloud_of(12)
    before, after = (cloud.means, unit(cloud.quats_wxyz)), cloud_of(12)
    now = cloud.means + 0.3 * after.log_scales, unit(cloud.quats_wxyz + 0.2 * after.quats_wxyz)
    near = neighbourhood(cloud.means)
    first, then = (matrices(q).numpy() for q in (before[1], now[1]))
    gap, total = float(near.distances.mean()), 0.0
    turns = product(now[1], before[1] * torch.tensor([1.0, -1, -1, -1])).numpy()
    for i in range(12):
        for j, weight in zip(near.indices[i].tolist(), near.weights[i].tolist(), strict=True):
            old, new = (p.numpy()[j] - p.numpy()[i] for p in (before[0], now[0]))
            rigid = np.linalg.norm(old - first[i] @ np.linalg.inv(then[i]) @ new) / gap
            isometry = abs(np.linalg.norm(old) - np.linalg.norm(new)) / gap
            rotation = np.linalg.norm(turns[j] - turns[i])
            total += weight * (RIGID * rigid + ROTATION * rotation + ISOMETRY * isometry) / 12
    assert float(rigidity(near, before, now)) == pytest.approx(total, rel=1e-4)


@pytest.mark.parametrize("distance", [0.0, 1e-30, 1e-3, 1e3, 1e30])
def test_weights_of_neighbours_sum_to_one_whatever_their_distance(distance):
    weights = weights_of(torch.tensor([[1.0, 2.0, 3.0], [1.0, 1.0, 1.0]]) * distance)
    torch.testing.assert_close(weights.sum(dim=1), torch.ones(2))
    assert torch.allclose(weights[1], torch.full((3,), 1 / 3))
    if distance:
        assert weights[0, 0] > weights[0, 1] > weights[0, 2] > 0


def test_a_far_neighbour_weighs_nothing():
    weights = weights_of(torch.tensor([[1e-6, 1.0, 1.0, 1.0]]))
    assert float(weights[0, 0]) > 0.45
    assert math.isfinite(float(weights.sum()))


@pytest.mark.parametrize("n", [0, 1, 2])
def test_none_one_or_two_of_them_in_one_place(n):
    cloud = cloud_of(n)
    cloud.means[:] = 1.0
    cloud.quats_wxyz[:] = 0.0
    motion = TimestepMotion.started(cloud.means)
    for done in (0.0, FIRST, 1.0):
        motion.advance(cloud, done)
        leaves = [t.requires_grad_() for t in (cloud.means, cloud.quats_wxyz)]
        penalty = motion.penalty(cloud)
        assert (penalty is None) == (done < FIRST or n < 2)
        now = motion.at(cloud, 1.0)
        assert all(torch.isfinite(t).all() for t in now)
        (now.means.sum() + now.quats_wxyz.sum() + (penalty if penalty is not None else 0)).backward()
        assert all(t.grad is None or torch.isfinite(t.grad).all() for t in leaves)
        for t in leaves:
            t.requires_grad_(False)
