"""Keeps what a step has learnt within what a scene can hold: light that pixels can fire, sizes that views can show."""

from collections.abc import Iterable

import torch
from torch import Tensor

from acquisition.spikes.stream import MOST_LIGHT
from reconstruction.training.optimizer import Optimizer

WIDEST = 0.3  # largest size of a Gaussian, in its distances from the cameras: a pole may be one, and no more is needed


@torch.no_grad()
def keep_light(optimizer: Optimizer) -> None:
    """Put light that a step took beyond 0 or MOST_LIGHT back: what few views ask for may be no light at all."""
    for group in optimizer.param_groups:
        if group.get("light"):  # not in the checkpoint of an earlier revision
            for tensor in group["params"]:
                tensor.clamp_(0.0, MOST_LIGHT)


@torch.no_grad()
def keep_sizes(tensors: Iterable[tuple[str, Tensor]], center: Tensor, usual_m: float) -> None:
    """Put Gaussians that grew too large back to WIDEST: an edge that few views see can stretch one without end.

    `center` [3] (m) is the middle of the cameras, and `usual_m` how far off movers are taken to be: they may be stored
    in frames of their bodies.
    """
    known = dict(tensors)
    for name, log_scales in known.items():
        part, _, kind = name.partition(".")
        if kind != "log_scales":
            continue
        away = torch.full((1, 1), usual_m).to(log_scales)
        if part == "still":
            away = (known["still.means"] - center.to(log_scales)).norm(dim=1, keepdim=True).clamp(min=1e-3 * usual_m)
        log_scales.copy_(torch.minimum(log_scales, (WIDEST * away).log()))
