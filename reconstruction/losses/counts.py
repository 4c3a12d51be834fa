"""Rendered light against what the camera measured: spike counts, not an image made of them.

Letters: Q parts of a window, H rows, W columns. A pixel's count over a window is the light it gathered within one
spike: with a random phase it errs by a variance of 1/6, and shot noise and uneven pixels add to it. All losses are
means over the pixels in spikes per tick, so that windows of any length pull alike.
"""

import torch
from torch import Tensor

from reconstruction.errors import ReconstructionError

PHASE_VARIANCE = 1 / 6  # spikes^2; the count of an integrate-and-fire pixel whose phase is random
ELECTRONS_PER_SPIKE = 5e4
GAIN_SPREAD = 0.01  # what a flat-field correction leaves


def rate_deviation(rate: Tensor, planes: int) -> Tensor:
    """Standard deviation of a rate [H, W] in spikes per tick that was counted over so many planes."""
    if planes < 1:
        raise ReconstructionError(f"found a window of {planes} planes", "at least 1")
    shot = rate / (ELECTRONS_PER_SPIKE * planes)
    return torch.sqrt(PHASE_VARIANCE / planes**2 + shot + (GAIN_SPREAD * rate) ** 2)


def absolute_loss(light: Tensor, rate: Tensor, planes: int) -> Tensor:
    """Return the mean absolute difference of light [H, W] and a rate [H, W] counted over any number of planes."""
    return (light - rate).abs().mean()


def square_loss(light: Tensor, rate: Tensor, planes: int) -> Tensor:
    """Return the mean squared difference of light [H, W] and a rate [H, W] counted over any number of planes."""
    return (light - rate).square().mean()


def robust_loss(light: Tensor, rate: Tensor, planes: int, *, reach: float = 3.0) -> Tensor:
    """Charbonnier loss of light [H, W] against a counted rate [H, W].

    A square within `reach` standard deviations, so that coarse counts pull to their mean, an absolute value beyond.
    """
    width = reach * rate_deviation(rate, planes)
    return (torch.sqrt(width * width + (light - rate) ** 2) - width).mean()


def cumulative_loss(light: Tensor, counts: Tensor, planes: int) -> Tensor:
    """Running totals of light and spikes over Q equal parts of `planes` each, whatever the phase at the start.

    light [Q, H, W] in spikes per tick, counts [Q, H, W] in spikes. The phase is an unknown shift of a pixel's total,
    so the mean gap of its Q totals is taken out; within the half spike that phases explain nothing pulls.
    """
    gaps = (light * planes - counts).cumsum(dim=0)
    beyond = ((gaps - gaps.mean(dim=0)).abs() - 0.5).clamp_min(0)
    return beyond.mean() / (planes * len(light))
