"""Losses of light that is made to spike against recorded spikes: how counts change over consecutive windows.

Letters: T windows, H rows, W columns. A pixel that integrates and fires has counted floor(phase + charge) spikes when
it has gathered a `charge`, in spikes. Its phase is not known, so counts are taken in expectation over an even one.

SPSS, the loss of Spike4DGS, turns renders into spikes and compares differences of successive frames by their mean and
by their variance. The paper says no more. Ours: frames are counts over windows, and the measure is Charbonnier's, a
square within one spike and an absolute value beyond. Under an absolute value alone coarse counts would pull to their
median, which for short windows is that nothing changes.
"""

from collections.abc import Sequence

import torch
from torch import Tensor


def expected_square(charges: Sequence[Tensor], signs: Sequence[int]) -> Tensor:
    """Return the mean over an even phase of the square of sum(sign * floor(phase + charge)), in spikes^2.

    `charges` are tensors of one shape, in spikes; `signs` sum to zero, so that whole spikes of the phase do not count.
    It is exact: floor(phase + charge) is floor(charge), and one more where the phase is above 1 - the fraction f. Two
    such events both happen in the smaller of both fractions. Continuous, with a gradient almost everywhere.
    """
    floors = [charge.floor() for charge in charges]
    whole = torch.stack([sign * floor for sign, floor in zip(signs, floors, strict=True)]).sum(dim=0)
    parts = [(sign, charge - floor) for sign, charge, floor in zip(signs, charges, floors, strict=True)]
    first = torch.stack([sign * f for sign, f in parts]).sum(dim=0)
    second = torch.stack([a * b * torch.minimum(f, g) for a, f in parts for b, g in parts]).sum(dim=0)
    return whole**2 + 2 * whole * first + second


def spike_variation_loss(charges: Tensor, counts: Tensor, gaps: Tensor | None = None) -> Tensor:
    """Return the scalar loss of the charges [T, H, W] of windows against recorded counts [T, H, W].

    Both are in spikes. `gaps` [T - 1, H, W]: the charge between the end of each window and the begin of the next,
    below zero where they overlap; none where they are consecutive. T is 2 or more; with two, nothing varies.
    """
    changes = counts.diff(dim=0)
    mean_gap = (charges[-1] - charges[0] - counts[-1] + counts[0]) / len(changes)
    variance_gap = expected_variance(charges, gaps) - changes.var(dim=0, correction=0)
    return _measure(mean_gap).mean() + _measure(variance_gap).mean()


def _measure(gap: Tensor) -> Tensor:
    return (1 + gap**2).sqrt() - 1


def expected_variance(charges: Tensor, gaps: Tensor | None = None) -> Tensor:
    """Return the expected variance [H, W] of the differences of the counts that such charges make, in spikes^2.

    A window's begin counts to whole spikes only, so that long recordings lose no precision.
    """
    after = charges[:-1] if gaps is None else charges[:-1] + gaps
    begins = torch.cat([torch.zeros_like(charges[:1]), (after - after.floor()).cumsum(dim=0)])
    ends, steps = begins + charges, len(charges) - 1

    def square(first: int, second: int) -> Tensor:
        return expected_square((begins[first], ends[first], begins[second], ends[second]), (1, -1, -1, 1))

    squares = torch.stack([square(k, k + 1) for k in range(steps)]).mean(dim=0)
    return (squares - square(0, steps) / steps**2).clamp_min(0)
