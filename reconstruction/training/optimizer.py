"""Makes the optimiser of a model, and sets its learning rates as the training goes on."""

from collections.abc import Mapping

import torch
from torch import Tensor

from reconstruction.methods.definition import AS_KIND, RateFactors
from reconstruction.native import fits
from reconstruction.scene_model import SceneModel
from reconstruction.training.adam import BETAS, EPS, Adam

FINAL_LENGTH, FINAL = 0.05, 1 / 3  # share of its first rate that a tensor of lengths, and any other, ends with
SETTLING = 120  # steps at first rates that the last rate of still Gaussians in a long training is worth
PARTS = {"still": "still", "field": "moving", "moving": "moving", "motion": "motion", "shifts": "motion"}
Optimizer = Adam | torch.optim.Adam
AdamStates = Mapping[str, Mapping[str, Tensor]]  # by the name of a tensor, as torch keeps them


def optimizer_of(
    model: SceneModel, units: Mapping[str, float], factors: RateFactors = AS_KIND, states: AdamStates | None = None
) -> Optimizer:
    """Return Adam over the tensors that have a rate.

    `units` says what a rate of each unit is multiplied by, `factors` what those of each part are, `states` what it
    knows of tensors from before.
    """
    groups, rates = [], model.rates()
    for name, tensor in model.tensors():
        if tensor.numel() == 0 or name not in rates:
            continue
        tensor.requires_grad_(True)
        rate = rates[name]
        start = rate.start * units[rate.unit] * getattr(factors, PARTS[name.partition(".")[0]])
        flags = {"field": rate.deforms, "moves": not name.startswith("still"), "length": rate.unit == "scene"}
        groups.append({"params": [tensor], "lr": start, "start": start, "light": rate.unit == "light", **flags})
    native = all(fits(tensor) for group in groups for tensor in group["params"])
    optimizer = Adam(groups) if native else torch.optim.Adam(groups, betas=BETAS, eps=EPS)
    for name, tensor in model.tensors():
        if states and tensor.requires_grad and name in states:
            optimizer.state[tensor] = {key: value.clone() for key, value in states[name].items()}
    return optimizer


def states_of(optimizer: Optimizer, model: SceneModel) -> dict[str, dict[str, Tensor]]:
    """Return what the optimiser knows of the tensors of its model, by name; nothing of one without a step."""
    known = {id(tensor): state for tensor, state in optimizer.state.items()}
    return {name: dict(known[id(tensor)]) for name, tensor in model.tensors() if known.get(id(tensor))}


def anneal(optimizer: Optimizer, done: float, stage: float, steps: int, canonical_until: float) -> None:
    """Set the rates at `done` (0 to 1) of the training, after `steps`, and those of movers at their own `stage`.

    A deformation does not learn before `canonical_until` of the training.
    """
    still = final(steps / done) if done > 0 else FINAL
    for group in optimizer.param_groups:
        begun = not group["field"] or done >= canonical_until
        share = min(max(stage if group["moves"] else done, 0.0), 1.0)
        end = FINAL if group["moves"] else still
        group["lr"] = group["start"] * (FINAL_LENGTH if group["length"] else end) ** share if begun else 0.0


def final(steps: float) -> float:
    """Return the share of its first rate that a tensor of still Gaussians ends with in a training of so many steps.

    A short training lacks distance at its end. A long one goes on to fit its few views closer than the scene does.
    """
    return min(FINAL, SETTLING / max(steps, 1.0))
