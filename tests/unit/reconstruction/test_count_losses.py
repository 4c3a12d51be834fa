import math

import numpy as np
import pytest
import torch

from acquisition.spikes.sensor import Sensor
from reconstruction.errors import ReconstructionError
from reconstruction.losses.counts import cumulative_loss, rate_deviation, robust_loss


def spikes(level: float, planes: int, size: int = 64) -> torch.Tensor:
    """Planes [T, H, W] of an ideal sensor under steady even light."""
    light = np.full((planes, size, size), level, dtype=np.float32)
    return torch.from_numpy(Sensor(size, size, "ideal", 1, 0).expose(light).astype(np.float64))


@pytest.mark.parametrize("planes", [7, 33])
def test_the_deviation_is_that_of_counted_rates(planes):
    found = spikes(0.3717, planes).mean(dim=0)
    quantised = math.sqrt(1 / 6) / planes
    assert float((found - 0.3717).square().mean().sqrt()) == pytest.approx(quantised, rel=0.25)
    assert float(rate_deviation(torch.tensor(0.0), planes)) == pytest.approx(quantised, rel=1e-6)


def test_a_window_without_planes_is_refused():
    with pytest.raises(ReconstructionError, match="found a window of 0 planes"):
        rate_deviation(torch.zeros(1), 0)


def test_the_robust_loss_finds_the_mean_of_coarse_counts_where_an_absolute_value_would_not():
    rate = spikes(0.1, 4).mean(dim=0)  # 0 mostly, 1/4 now and then
    light = torch.linspace(0, 0.3, 61, dtype=torch.float64)
    best = {
        "robust": float(light[torch.stack([robust_loss(x, rate, 4).mean() for x in light]).argmin()]),
        "absolute": float(light[torch.stack([(rate - x).abs().mean() for x in light]).argmin()]),
    }
    assert best["robust"] == pytest.approx(0.1, abs=0.015)
    assert best["absolute"] == pytest.approx(0.0, abs=0.015)


def test_a_window_of_any_length_pulls_alike_on_a_large_error():
    light = torch.full((4, 4), 0.9, dtype=torch.float64, requires_grad=True)
    pulls = []
    for planes in (8, 512):
        loss = robust_loss(light, torch.full((4, 4), 0.1, dtype=torch.float64), planes).mean()
        (gradient,) = torch.autograd.grad(loss, light)
        pulls.append(float(gradient.sum()))
    assert pulls[0] == pytest.approx(pulls[1], rel=0.1)


def test_true_light_costs_nothing_whatever_the_phase():
    level, planes, parts = 0.37, 16, 4
    counts = spikes(level, planes * parts).unflatten(0, (parts, planes)).sum(dim=1)
    light = torch.full(counts.shape, level, dtype=torch.float64)
    assert float(cumulative_loss(light, counts, planes)) < 2e-3
    assert float(cumulative_loss(light * 1.5, counts, planes)) > 0.02


@pytest.mark.parametrize("level", [0.0, 1e-12, 1.0, 1e6])
def test_dark_and_huge_light_have_finite_gradients(level):
    light = torch.full((2, 3, 3), level, dtype=torch.float64, requires_grad=True)
    rate = torch.full((3, 3), 0.5, dtype=torch.float64)
    total = robust_loss(light[0], rate, 8).mean() + cumulative_loss(light, rate.expand(2, 3, 3), 8)
    (gradient,) = torch.autograd.grad(total, light)
    assert torch.isfinite(gradient).all()


def test_gradients_are_the_numerical_ones():
    generator = torch.Generator().manual_seed(0)
    light = torch.rand(3, 4, 4, dtype=torch.float64, generator=generator, requires_grad=True)
    counts = torch.randint(0, 9, (3, 4, 4), generator=generator).double()
    assert torch.autograd.gradcheck(lambda x: robust_loss(x[0], counts[0] / 8, 8), (light,))
    assert torch.autograd.gradcheck(lambda x: cumulative_loss(x, counts, 8), (light,))
