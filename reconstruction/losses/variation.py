"""The variation loss of Spike4DGS: how much light changes on average over time, and how much that change varies.

Letters: T instants, H rows, W columns. With d the differences of successive frames,
L = mean |mean_t d(render) - mean_t d(spikes)| + mean |sd_t d(render) - sd_t d(spikes)|.
The paper states the idea, mean and variance over frame differences. Ours: sd = sqrt(variance + eps), so that a pixel
that never changes has a zero gradient instead of an infinite one.
"""

import torch
from torch import Tensor

EPS = 1e-8  # (spikes per tick)^2


def variation_loss(rendered: Tensor, target: Tensor) -> Tensor:
    """Return the scalar loss of frames [T, H, W] against targets [T, H, W] in spikes per tick; T is 2 or more."""
    d_rendered, d_target = rendered.diff(dim=0), target.diff(dim=0)
    mean_gap = (d_rendered.mean(dim=0) - d_target.mean(dim=0)).abs().mean()
    return mean_gap + (_deviation(d_rendered) - _deviation(d_target)).abs().mean()


def _deviation(differences: Tensor) -> Tensor:
    return torch.sqrt((differences - differences.mean(dim=0)).square().mean(dim=0) + EPS)
