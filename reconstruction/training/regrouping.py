"""Decides early in a training which Gaussians ride on one body, and keeps what the optimiser knows of them.

A body begins in parts that learn a motion each. Parts that move alike by then are one body.
"""

from dataclasses import replace

import torch
from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.parts import joined
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.scene_model import SceneModel
from reconstruction.training.optimizer import AdamStates

JOINED_AT = 0.25  # share of the training before bodies are made of parts
GAP_PX = 1.0  # how far a body may take its parts aside
KNOTS = {"motion.knot_quats", "motion.knot_centers"}  # tensors that have a row a body
TURNED = {"moving.means", "moving.quats_wxyz"}  # tensors whose rows are seen from another body


@torch.no_grad()
def regrouped(
    cloud: SceneModel, states: AdamStates, gap_m: float
) -> tuple[SceneModel, dict[str, dict[str, Tensor]]] | None:
    """Return the cloud with parts joined that one body takes at most `gap_m` aside; None where there are none.

    Beside it are Adam's `states` of its tensors: the squares of a body are the sums of those of its parts, as those of
    gradients are in the mean, and directions are forgotten where frames are others.
    """
    if not (isinstance(cloud, DynamicCloud) and isinstance(cloud.motion, RigidMotion)):
        return None
    here = _on(torch.device("cpu"), cloud)
    found = joined(here, gap_m)
    if found is here:
        return None
    assert isinstance(found.motion, RigidMotion)
    kept = {name: dict(state) for name, state in states.items()}
    numbers = torch.zeros(len(cloud.motion.knot_quats), dtype=torch.int64)
    numbers[cloud.motion.bodies.cpu()] = found.motion.bodies
    for name in kept.keys() & (KNOTS | TURNED):
        squares = kept[name]["exp_avg_sq"]
        if name in KNOTS:
            body = numbers.to(squares.device)
            squares = squares.new_zeros(len(found.motion.knot_quats), *squares.shape[1:]).index_add(0, body, squares)
        kept[name] |= {"exp_avg": torch.zeros_like(squares), "exp_avg_sq": squares}
    return _on(cloud.moving.means.device, found), kept


def _on(device: torch.device, cloud: DynamicCloud) -> DynamicCloud:
    """Return the cloud with its movers on a device; nothing else is looked at to join them."""
    if cloud.moving.means.device == device:
        return cloud
    moved = lambda part: {key: t.detach().cpu().to(device) for key, t in vars(part).items()}  # noqa: E731
    motion = RigidMotion(**moved(cloud.motion))
    return replace(cloud, moving=GaussianCloud(**moved(cloud.moving)), motion=motion)


def bodies_of(cloud: SceneModel) -> int:
    """Return the number of bodies of a model, or of parts of bodies; 0 where it has none."""
    motion = cloud.motion if isinstance(cloud, DynamicCloud) else None
    return len(motion.knot_quats) if isinstance(motion, RigidMotion) else 0
