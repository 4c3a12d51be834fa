"""Rigid bodies: the curve of their poses, what rides on them, gradients, and cases with nothing to ride on."""

import math

import numpy as np
import pytest
import torch

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.riding import carried, carried_reference
from reconstruction.gaussians.rigid import RigidMotion, knot_weights
from reconstruction.quaternions import matrices, product, rotated


def turning(bodies: int = 2, knots: int = 5, attached: int = 4, free: int = 3) -> tuple[GaussianCloud, RigidMotion]:
    """A float64 cloud on bodies that turn up to a radian about z and go along x."""
    generator = torch.Generator().manual_seed(0)
    draw = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)  # noqa: E731
    n = attached + free
    angles = torch.linspace(0, 1, knots, dtype=torch.float64) * torch.arange(1, bodies + 1)[:, None]
    zero = torch.zeros_like(angles)
    motion = RigidMotion(
        torch.arange(attached) % max(bodies, 1),
        torch.stack([(angles / 2).cos(), zero, zero, (angles / 2).sin()], dim=-1),
        torch.stack([angles, zero, zero + 2], dim=-1),
        draw(free, 3),
        torch.full((n,), 0.5, dtype=torch.float64),
        draw(n) * 0.1,
    )
    return GaussianCloud(draw(n, 3), draw(n, 4), draw(n, 3), draw(n), draw(n, 1)), motion


@pytest.mark.parametrize("knots", [1, 2, 3, 17])
def test_the_curve_passes_through_its_knots_and_keeps_straight_lines(knots):
    values = torch.arange(knots, dtype=torch.float64)
    for i in range(knots):
        weights = knot_weights(i / max(knots - 1, 1), knots)
        assert float(weights @ values) == pytest.approx(i, abs=1e-12)
    for u in np.linspace(0, 1, 23):
        weights = knot_weights(float(u), knots)
        assert float(weights.sum()) == pytest.approx(1, abs=1e-12)
        assert float(weights @ values) == pytest.approx(u * (knots - 1), abs=1e-12)


def test_the_velocity_is_continuous_over_the_knots():
    values = torch.tensor([0.0, 1.0, -0.5, 2.0, 0.3], dtype=torch.float64)
    at = lambda u: float(knot_weights(u, 5) @ values)  # noqa: E731
    for u in (0.25, 0.5, 0.75):
        assert (at(u) - at(u - 1e-6)) / 1e-6 == pytest.approx((at(u + 1e-6) - at(u)) / 1e-6, abs=1e-3)


@pytest.mark.parametrize("u", [-1e9, -0.2, 1.3, 1e9])
def test_outside_the_clip_a_body_stays_where_it_was_at_its_end(u):
    _, motion = turning()
    for outside, end in zip(motion.poses(u), motion.poses(float(u > 0)), strict=True):
        assert torch.equal(outside, end)


def test_what_rides_on_a_body_keeps_its_shape_and_turns_with_it():
    cloud, motion = turning(bodies=1)
    before, after = motion.at(cloud, 0.0), motion.at(cloud, 1.0)
    at = slice(0, 4)
    torch.testing.assert_close(
        torch.cdist(after.means[at], after.means[at]), torch.cdist(cloud.means[at], cloud.means[at])
    )
    turned = matrices(after.quats_wxyz[at]) @ matrices(before.quats_wxyz[at]).mT
    c, s = math.cos(1), math.sin(1)
    expected = torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]], dtype=torch.float64)
    torch.testing.assert_close(turned, expected.expand(4, 3, 3), atol=1e-12, rtol=0)
    torch.testing.assert_close(after.means[at], cloud.means[at] @ expected.T + motion.knot_centers[0, -1])


def test_a_drift_takes_a_rider_straight_from_where_its_body_has_it():
    cloud, motion = turning()
    carried_along = motion.at(cloud, 0.75).means
    motion.drifts[1] = torch.tensor([0.4, 0.0, -0.8])
    moved = motion.at(cloud, 0.75).means - carried_along
    expected = torch.zeros(7, 3, dtype=torch.float64)
    expected[1] = torch.tensor([0.1, 0.0, -0.2])  # a quarter of the clip after its own instant
    torch.testing.assert_close(moved, expected)


def test_riders_of_an_earlier_revision_do_not_drift():
    _, motion = turning()
    stored = {name: tensor for name, tensor in motion.tensors() if name != "drifts"}
    assert torch.equal(RigidMotion(**stored).drifts, torch.zeros(4, 3, dtype=torch.float64))


def test_free_ones_go_straight_whatever_the_bodies_do():
    cloud, motion = turning()
    now = motion.at(cloud, 0.75)
    torch.testing.assert_close(now.means[4:], cloud.means[4:] + 0.25 * motion.velocities)
    assert torch.equal(now.quats_wxyz[4:], cloud.quats_wxyz[4:])


@pytest.mark.parametrize(("bodies", "attached", "free"), [(0, 0, 3), (1, 1, 0), (2, 4, 0), (0, 0, 0)])
def test_any_share_may_be_empty(bodies, attached, free):
    cloud, motion = turning(bodies, attached=attached, free=free)
    now = motion.at(cloud, 0.3)
    assert now.means.shape == (attached + free, 3)
    assert all(torch.isfinite(t).all() for t in now)


def test_quaternions_turn_vectors_as_their_matrices_do():
    left, right = (torch.nn.functional.normalize(torch.randn(6, 4, dtype=torch.float64), dim=-1) for _ in range(2))
    vectors = torch.randn(6, 3, dtype=torch.float64)
    torch.testing.assert_close(rotated(left, vectors), (matrices(left) @ vectors[..., None])[..., 0])
    torch.testing.assert_close(matrices(product(left, right)), matrices(left) @ matrices(right))


@pytest.mark.parametrize("u", [0.0, 0.31, 0.98])
def test_gradients_agree_with_numerical_ones(u):
    cloud, motion = turning()
    learnt = [t.requires_grad_() for name, t in (*vars(cloud).items(), *motion.tensors()) if name != "bodies"]

    def outputs(*tensors):
        moving, rest = GaussianCloud(*tensors[:5]), tensors[5:]
        return tuple(RigidMotion(motion.bodies, *rest).at(moving, u))

    assert torch.autograd.gradcheck(outputs, learnt)


def riders(count: int, bodies: int, scale: float = 1.0) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(count)
    draw = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)  # noqa: E731
    turns = draw(bodies, 4)
    return [scale * draw(count, 3), draw(count, 4), turns / turns.norm(dim=-1, keepdim=True), scale * draw(bodies, 3)]


@pytest.mark.parametrize(("count", "bodies"), [(0, 0), (0, 2), (1, 1), (13, 3), (1000, 7)])
@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 2e3])
def test_riders_and_their_gradients_are_the_references(count, bodies, threads, scale):
    exact = [t.requires_grad_(True) for t in riders(count, bodies, scale)]
    single = [t.detach().float().requires_grad_(True) for t in exact]
    owners = torch.randint(max(bodies, 1), (count,), generator=torch.Generator().manual_seed(1))
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        results = []
        for function, leaves in ((carried_reference, exact), (carried, single)):
            means, quats = function(leaves[0], leaves[1], owners, leaves[2], leaves[3])
            (means.sin().sum() + (quats * quats.roll(1, dims=-1)).sum()).backward()
            results.append([means, quats, *(leaf.grad for leaf in leaves)])
    finally:
        torch.set_num_threads(before)
    for wanted, found in zip(*results, strict=True):
        largest = max(1.0, scale, float(wanted.detach().abs().amax())) if wanted.numel() else 1.0
        torch.testing.assert_close(found.double(), wanted, rtol=1e-4, atol=2e-5 * largest * max(1.0, scale))


def test_the_references_gradient_is_that_of_finite_differences():
    leaves = [t.requires_grad_(True) for t in riders(5, 2)]
    owners = torch.tensor([0, 1, 1, 0, 1])
    assert torch.autograd.gradcheck(lambda m, q, t, c: carried_reference(m, q, owners, t, c), leaves)
