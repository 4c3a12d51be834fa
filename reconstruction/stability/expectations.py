"""Defines the cases of expectations: light that is made to spike, sums of weights over maps, and expected errors."""

import math

import torch
from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.gaussians.spanned import nothing
from reconstruction.losses.spiking import expected_variance
from reconstruction.rendering.native import attribute
from reconstruction.rendering.render import render
from reconstruction.rendering.result import Instantaneous
from reconstruction.scene_model import TimeSpan
from reconstruction.stability.case import Case, Observation
from reconstruction.stability.probe import CAMERA, apart, gaussians_of, natives, running
from reconstruction.uncertainty.evidence import Evidence, SceneEvidence
from reconstruction.uncertainty.expected_error import (
    FARTHEST,
    NARROWEST_RAD,
    WEIGHTS,
    Uncertainty,
    quadratic_inverse,
)

LEAST_VARIANCE = 1e-3  # spikes^2, below which a variance is compared as if it were so much


def _spiking(_: str) -> Observation:
    """Take windows of 0 to 1,000 spikes, whole ones and nearly whole ones among them, in both precisions."""
    steps = torch.tensor([0.0, 1e-12, 0.5, 1.0, 1 - 1e-7, 3.0, 33.3, 1000.25], dtype=torch.float64)
    charges = torch.stack([steps.roll(shift) for shift in range(5)])
    found = []
    for dtype in (torch.float32, torch.float64):
        leaf = charges.to(dtype).requires_grad_()
        variance = expected_variance(leaf)
        variance.sum().backward()
        assert leaf.grad is not None
        found.append((variance.detach().double(), leaf.grad.isfinite().all().item()))
    error = float(((found[0][0] - found[1][0]).abs() / found[1][0].clamp_min(LEAST_VARIANCE)).max())
    finite = all(sound for _, sound in found)
    return Observation(f"off by {error:.0e}", error if finite else math.inf)


def _attributed(renderer: str) -> Observation:
    """Hold sums of weights against gradients by intensity in float64: stacked, faint, opaque and dead Gaussians."""
    maps = torch.rand(3, 28, 40, generator=torch.Generator().manual_seed(2))
    error = 0.0
    for opacity in (0.0, 1e-3, 0.7, 1.0):
        cloud = gaussians_of(200, opacities=torch.full((200,), opacity))
        with running(renderer):
            _, sums = attribute(cloud, CAMERA, lambda _: maps)
        error = max(error, apart(sums.double(), _by_intensity(cloud, maps)))
    return Observation(f"off by {error:.0e}", error)


def _by_intensity(cloud: Instantaneous, maps: Tensor) -> Tensor:
    leaves = Instantaneous(*(t.double() for t in cloud))
    leaves.intensities.requires_grad_()
    light, which = render(leaves, CAMERA, backend="reference").intensity[..., 0], leaves.intensities
    return torch.cat([torch.autograd.grad(light, which, m.double(), retain_graph=True)[0] for m in maps], dim=1)


def _expected_error(_: str) -> Observation:
    """Show one Gaussian that nobody saw, with misfits from 0 to 1e6 and a known breadth; all is finite."""
    now, error = gaussians_of(1), 0.0
    still = GaussianCloud(now.means, now.quats_wxyz, now.log_scales, now.opacities.logit(), now.intensities)
    cloud = DynamicCloud(still, nothing(), PolynomialMotion.at_rest(torch.zeros(0), 1.0), TimeSpan(0.0, 1.0))
    alpha, breadth = render(now, CAMERA, backend="reference").alpha, 0.1 / float(now.means.norm())
    for misfit in (0.0, 1e-12, 1.0, 1e6):
        known = Evidence(torch.tensor([misfit]), torch.zeros(1, 1, dtype=torch.bool))
        none = Evidence(torch.zeros(0), torch.zeros(0, 1, dtype=torch.bool))
        told = Uncertainty(cloud, SceneEvidence(known, [none], now.means, 1.0, 0.5))
        terms = dict(zip(WEIGHTS, told.terms(CAMERA, 0.5), strict=True))
        outside = misfit * breadth * FARTHEST * alpha
        error = max(error, apart(terms["misfit"], misfit * alpha), apart(terms["misfit outside"], outside))
        error = max(error, apart(terms["holes"], 0.5 * (1 - alpha)))
        if not all(bool(torch.isfinite(term).all()) for term in terms.values()):
            error = math.inf
    return Observation(f"off by {error:.0e}", error)


def _leverage(_: str) -> Observation:
    """Hold leverages against solved equations in float64: cameras in one place, in a row, apart, near and far."""
    rng, error = torch.Generator().manual_seed(3), 0.0
    for spread_m in ((0.0, 0.0, 0.0), (1e-6, 0.0, 0.0), (0.1, 0.0, 0.0), (0.1, 0.1, 0.0), (3.0, 3.0, 3.0)):
        for depth_m in (0.02, 1.0, 1e6):
            ways = torch.randn(50, 8, 3, generator=rng) * torch.tensor(spread_m) + torch.tensor([0.0, 0.0, depth_m])
            directions = torch.nn.functional.normalize(ways, dim=2)
            gaps = directions - directions.mean(dim=1, keepdim=True)
            spread = gaps.transpose(1, 2) @ gaps + NARROWEST_RAD**2 * torch.eye(3)
            off = torch.randn(50, 3, generator=rng)
            wanted = (off.double() * torch.linalg.solve(spread.double(), off.double())).sum(dim=1)
            error = max(error, apart(quadratic_inverse(spread, off), wanted))
    return Observation(f"off by {error:.0e}", error)


CASES = (
    Case(None, "light that spikes, 0 to 1,000 a window", "each as in float64, finite gradients", 1e-5, _spiking),
    Case(None, "sums of weights over maps", "the gradient by intensity", 1e-5, _attributed, natives),
    Case(None, "leverage, cameras from one place to metres apart", "as solved in float64", 1e-5, _leverage),
    Case(None, "expected errors, misfits 0 to 1e6", "known where it is", 1e-5, _expected_error),
)
