"""Makes the optimiser of a model, and sets its learning rates as the training goes on."""

from collections.abc import Mapping

import torch

from reconstruction.scene_model import SceneModel
from reconstruction.training.adam import BETAS, EPS, Adam

FINAL_LENGTH, FINAL = 0.05, 1 / 3  # share of its first rate that a tensor of lengths, and any other, ends with
Optimizer = Adam | torch.optim.Adam


def optimizer_of(model: SceneModel, units: Mapping[str, float]) -> Optimizer:
    """Return Adam over the tensors that have a rate; `units` says what a rate of each unit is multiplied by."""
    groups, rates = [], model.rates()
    for name, tensor in model.tensors():
        if tensor.numel() == 0 or name not in rates:
            continue
        tensor.requires_grad_(True)
        rate = rates[name]
        start, end = rate.start * units[rate.unit], FINAL_LENGTH if rate.unit == "scene" else FINAL
        flags = {"field": rate.deforms, "moves": not name.startswith("still")}
        groups.append({"params": [tensor], "lr": start, "start": start, "end": end, **flags})
    if all(tensor.dtype == torch.float32 for group in groups for tensor in group["params"]):
        return Adam(groups)
    return torch.optim.Adam(groups, betas=BETAS, eps=EPS)


def anneal(optimizer: Optimizer, done: float, stage: float, canonical_until: float) -> None:
    """Set the rates at `done` (0 to 1) of the training, and those of movers at their own `stage`.

    A deformation does not learn before `canonical_until` of the training.
    """
    for group in optimizer.param_groups:
        begun = not group["field"] or done >= canonical_until
        share = min(max(stage if group["moves"] else done, 0.0), 1.0)
        group["lr"] = group["start"] * group["end"] ** share if begun else 0.0
