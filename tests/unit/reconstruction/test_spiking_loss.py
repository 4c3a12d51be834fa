"""Light that is made to spike: expectations against many phases, gradients, extremes, and the loss at the truth."""

import math

import numpy as np
import pytest
import torch

from reconstruction.losses.spiking import expected_square, expected_variance, spike_variation_loss

PHASES = 20_000


def phases() -> torch.Tensor:
    return (torch.arange(PHASES, dtype=torch.float64) + 0.5) / PHASES


def fired(charges, gaps=None) -> torch.Tensor:
    """Counts [P, T] of the windows of one pixel that integrates `charges` [T], at every phase."""
    gaps = torch.zeros(len(charges) - 1).double() if gaps is None else gaps
    begins = torch.cat([torch.zeros(1).double(), (charges[:-1] + gaps).cumsum(0)])
    return (phases()[:, None] + begins + charges).floor() - (phases()[:, None] + begins).floor()


@pytest.mark.parametrize("signs", [(1, -1), (1, -2, 1), (1, -1, -1, 1)])
@pytest.mark.parametrize("seed", range(4))
def test_the_expected_square_is_the_mean_over_all_phases(signs, seed):
    charges = 5 * torch.rand(len(signs), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    spikes = sum(s * (phases() + c).floor() for s, c in zip(signs, charges, strict=True))
    found = expected_square(tuple(charges), signs)
    assert float(found) == pytest.approx(float(spikes.square().mean()), abs=2e-3)


ROWS = [(0.3, 0.3, 0.3), (0.05, 0.9, 2.2, 0.1), (1.0, 1.0, 1.0), (3.7, 0.0, 12.4, 12.4, 0.2)]


@pytest.mark.parametrize("charges", ROWS)
@pytest.mark.parametrize("gap", [None, 0.45, -0.2])
def test_the_expected_variance_is_that_of_fired_counts(charges, gap):
    values = torch.tensor(charges, dtype=torch.float64)
    gaps = None if gap is None else torch.full((len(values) - 1,), gap, dtype=torch.float64)
    changes = fired(values, gaps).diff(dim=1)
    found = expected_variance(values[:, None, None], None if gaps is None else gaps[:, None, None])
    assert float(found) == pytest.approx(float(changes.var(dim=1, correction=0).mean()), abs=2e-3)


def test_steady_light_varies_as_a_phase_makes_it():
    """Counts of one window are one spike apart: without motion all variance is of the phase."""
    for charge in (0.25, 0.5, 3.75):
        fraction = charge - math.floor(charge)
        pair = float(expected_square(tuple(torch.tensor([0.0, charge, 2 * charge]).double()), (1, -2, 1)))
        assert pair == pytest.approx(2 * min(fraction, 1 - fraction), abs=1e-9)


def test_its_gradient_is_that_of_its_differences():
    charges = 4 * torch.rand(5, 3, 2, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    charges.requires_grad_()
    counts = torch.randint(0, 5, (5, 3, 2), generator=torch.Generator().manual_seed(4)).double()
    gaps = 0.3 * torch.ones(4, 3, 2, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda c: expected_variance(c), (charges,), eps=1e-7, atol=1e-5)
    assert torch.autograd.gradcheck(lambda c: spike_variation_loss(c, counts, gaps), (charges,), eps=1e-7, atol=1e-5)


def test_it_is_continuous_where_a_charge_is_whole():
    around = [torch.tensor([0.7, x, 1.4], dtype=torch.float64)[:, None, None] for x in (2 - 1e-9, 2 + 1e-9)]
    below, above = map(expected_variance, around)
    assert float(below) == pytest.approx(float(above), abs=1e-7)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("level", [0.0, 1e-12, 1.0, 33.0, 1e4])
@pytest.mark.parametrize("windows", [2, 3, 9])
def test_extremes_are_finite_with_finite_gradients(dtype, level, windows):
    charges = torch.full((windows, 3, 5), level, dtype=dtype, requires_grad=True)
    counts = torch.zeros(windows, 3, 5, dtype=dtype)
    loss = spike_variation_loss(charges, counts)
    loss.backward()
    assert math.isfinite(float(loss.detach()))
    assert charges.grad is not None
    assert bool(charges.grad.isfinite().all())


def test_single_precision_is_that_of_double():
    charges = 30 * torch.rand(6, 8, 8, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    counts = charges.floor()
    double, single = spike_variation_loss(charges, counts), spike_variation_loss(charges.float(), counts.float())
    assert float(single) == pytest.approx(float(double), rel=1e-4)


@pytest.mark.parametrize("planes", [1, 4, 16])
def test_moving_light_explains_its_own_spikes_better_than_steady_light(planes):
    rng, windows, pixels = np.random.default_rng(5), 5, 4000
    slope = torch.linspace(-0.15, 0.15, windows, dtype=torch.float64)[:, None, None]
    rate = 0.45 + slope * torch.ones(windows, 1, pixels, dtype=torch.float64)
    charges, phase = planes * rate, torch.from_numpy(rng.random((1, 1, pixels)))
    ends = torch.cat([torch.zeros(1, 1, pixels).double(), charges.cumsum(0)])
    counts = (phase + ends).floor().diff(dim=0)
    steady = charges.mean(dim=0, keepdim=True).expand_as(charges)
    backwards = charges.flip(0)
    true, *wrong = (float(spike_variation_loss(light, counts)) for light in (charges, steady, backwards))
    assert true < min(wrong)
