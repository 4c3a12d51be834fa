"""Spacetime Gaussians against the paper's formulas in float64."""

import numpy as np
import pytest
import torch

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.spacetime import SpacetimeMotion


def drawn(n: int, dtype: torch.dtype) -> tuple[GaussianCloud, SpacetimeMotion]:
    generator = torch.Generator().manual_seed(n)
    draw = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64).to(dtype)  # noqa: E731
    motion = SpacetimeMotion(draw(n, 3), draw(n, 3), draw(n, 3), draw(n), 0.1 * draw(n), draw(n, 4))
    return GaussianCloud(draw(n, 3), draw(n, 4), draw(n, 3), draw(n), draw(n, 1)), motion


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 1e-5)])
@pytest.mark.parametrize("u", [-0.5, 0.0, 0.37, 1.0])
def test_it_follows_the_paper(u, dtype, tolerance):
    cloud, motion = drawn(7, dtype)
    now = motion.at(cloud, u)
    for i in range(7):
        t = {name: tensor[i].double().numpy() for name, tensor in motion.tensors()}
        s = u - t["instants"]
        place = cloud.means[i].double().numpy() + t["velocities"] * s
        place = place + t["accelerations"] * s**2 / 2 + t["jerks"] * s**3 / 6
        seen = 1 / (1 + np.exp(-float(cloud.opacity_logits[i]))) * np.exp(-((s / np.exp(t["log_durations"])) ** 2) / 2)
        np.testing.assert_allclose(now.means[i].double().numpy(), place, rtol=tolerance, atol=tolerance)
        turned = cloud.quats_wxyz[i].double().numpy() + s * t["turns"]
        np.testing.assert_allclose(now.quats_wxyz[i].double().numpy(), turned, rtol=tolerance, atol=tolerance)
        assert float(now.opacities[i]) == pytest.approx(float(seen), rel=10 * tolerance, abs=tolerance)
    assert torch.equal(now.log_scales, cloud.log_scales)
    assert torch.equal(now.intensities, cloud.intensities)


def test_gradients_agree_with_numerical_ones():
    cloud, motion = drawn(4, torch.float64)
    leaves = [t.requires_grad_() for t in (*vars(cloud).values(), *vars(motion).values())]

    def outputs(*tensors):
        return tuple(SpacetimeMotion(*tensors[5:]).at(GaussianCloud(*tensors[:5]), 0.37))

    assert torch.autograd.gradcheck(outputs, leaves, fast_mode=True)


def test_it_starts_standing_and_unturned():
    cloud, _ = drawn(5, torch.float32)
    motion = SpacetimeMotion.started(torch.full((5,), 0.3), 0.2)
    now = motion.at(cloud, 0.8)
    assert torch.equal(now.means, cloud.means)
    assert torch.equal(now.quats_wxyz, cloud.quats_wxyz)
