"""Losses of rendered light against spike counts.

Letters: Q parts of a window, H rows, W columns. A pixel's count over a window is the light it gathered to within one
spike: with a random phase its variance is 1/6, and shot noise and uneven pixels add to it. Losses are in spikes per
tick, so that windows of any length pull alike.
"""

import torch
from torch import Tensor

from acquisition.spikes.sensor import ELECTRONS_PER_SPIKE
from reconstruction.errors import ReconstructionError

PHASE_VARIANCE = 1 / 6  # spikes^2; the count of an integrate-and-fire pixel whose phase is random
GAIN_SPREAD = 0.01  # relative deviation of pixels after a flat-field correction


def rate_deviation(rate: Tensor, planes: int, noise: Tensor | float = 1.0) -> Tensor:
    """Return the standard deviation [H, W] of a `rate` [H, W] in spikes per tick that was counted over `planes` planes.

    `noise` [H, W]: the deviation as a share of a single pixel's, where rates are means over parts of several.

    Raises ReconstructionError for less than one plane.
    """
    if planes < 1:
        raise ReconstructionError(f"found a window of {planes} planes", "at least 1")
    shot = rate / (ELECTRONS_PER_SPIKE * planes)
    return noise * torch.sqrt(PHASE_VARIANCE / planes**2 + shot + (GAIN_SPREAD * rate) ** 2)


def absolute_loss(light: Tensor, rate: Tensor, planes: int, noise: Tensor | float = 1.0) -> Tensor:
    """Return |light - rate| [H, W] of light and a counted rate [H, W], in spikes per tick."""
    return (light - rate).abs()


def square_loss(light: Tensor, rate: Tensor, planes: int, noise: Tensor | float = 1.0) -> Tensor:
    """Return (light - rate)^2 [H, W] of light and a counted rate [H, W], in spikes per tick."""
    return (light - rate).square()


def robust_loss(light: Tensor, rate: Tensor, planes: int, noise: Tensor | float = 1.0, *, reach: float = 3.0) -> Tensor:
    """Return the Charbonnier loss [H, W] of light against a rate [H, W] counted over `planes`, in spikes per tick.

    It is a square within `reach` standard deviations of the rate, so that coarse counts pull to their mean, and an
    absolute value beyond.
    """
    width = reach * rate_deviation(rate, planes, noise)
    return torch.sqrt(width * width + (light - rate) ** 2) - width


def cumulative_loss(light: Tensor, counts: Tensor, planes: int, noise: Tensor | float = 1.0) -> Tensor:
    """Return the scalar loss of the running totals of light and spikes, whatever the phase at the start.

    `light` [Q, H, W] in spikes per tick and `counts` [Q, H, W] in spikes are of Q equal parts of `planes` planes. The
    phase is an unknown shift of a pixel's totals, so the mean gap of its Q totals is taken out; a gap within the half
    spike that the phase explains does not pull; of means over parts of several pixels, that times their `noise` [H, W].
    """
    gaps = (light * planes - counts).cumsum(dim=0)
    beyond = ((gaps - gaps.mean(dim=0)).abs() - 0.5 * noise).clamp_min(0)
    return beyond.mean() / (planes * len(light))
