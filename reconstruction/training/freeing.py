"""Lets still Gaussians move in the middle of a training, and carries what the optimiser knows of them over.

Letters: N still Gaussians.
"""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from reconstruction.initialization.seeding import LONG_LIFE
from reconstruction.scene_model import SceneModel
from reconstruction.training.checkpoint import model_from_state
from reconstruction.training.optimizer import AdamStates

FRESH = {  # values that the motion of a freed Gaussian starts from, by the kind of tensor
    **dict.fromkeys(("velocities", "accelerations", "jerks", "turns"), 0.0),
    "instants": 0.5,
    "log_durations": math.log(LONG_LIFE),
}
BENDS = ("accelerations", "jerks")  # kinds of tensors that stay empty for straight paths
MOMENTS = ("exp_avg", "exp_avg_sq")  # Adam's, by the names that torch gives them


def freed(cloud: SceneModel, which: Tensor) -> SceneModel:
    """Return the cloud with the still Gaussians of the mask `which` [N] moving: at rest so far, there all the time."""
    state = cloud.state()
    return model_from_state(state | {"tensors": _set_moving(state["tensors"], which, FRESH)})


def freed_states(cloud: SceneModel, states: AdamStates, which: Tensor) -> dict[str, dict[str, Tensor]]:
    """Return Adam's moments of every tensor of `freed(cloud, which)`, from its `states` for `cloud`.

    The moments of a motion that a Gaussian did not have before are zero.
    """
    moments = {}
    for key in MOMENTS:
        known = {n: states[n][key] if states.get(n) else torch.zeros_like(t) for n, t in cloud.tensors()}
        moments[key] = _set_moving(known, which, dict.fromkeys(FRESH, 0.0))
    return {name: {key: moments[key][name].clone() for key in MOMENTS} for name in moments[MOMENTS[0]]}


def _set_moving(tensors: Mapping[str, Tensor], which: Tensor, fresh: Mapping[str, float]) -> dict[str, Tensor]:
    """Return the tensors of a cloud, by name, with the still rows of the mask `which` [N] behind the moving ones.

    New rows of the motion hold the value that `fresh` has for their kind.
    """
    count, carried = int(which.sum()), {}
    for name, tensor in tensors.items():
        part, key = name.split(".")
        if part == "still":
            carried[name] = tensor[~which]
        elif part == "moving":
            carried[name] = torch.cat([tensor, tensors[f"still.{key}"][which]])
        elif key in fresh and (key not in BENDS or len(tensor)):
            rows = tensor.new_full((count, *tensor.shape[1:]), fresh[key])
            carried[name] = torch.cat([tensor, rows])
        else:
            carried[name] = tensor
    return carried
