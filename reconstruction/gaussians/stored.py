"""Stores tensors of a scene in as few bytes as no picture tells from more."""

from typing import Any, NamedTuple

import torch
from torch import Tensor

PRECISE = ("velocities", "accelerations", "jerks", "knot_quats", "knot_centers")  # kept in 32 bits
MIDDLE = 32_768  # of the steps that 16 bits count
HALF_MAX = 6e4  # within what half precision holds
NEARLY_UNIT = 0.02  # how far the length of a quaternion is off 1 at most, to be left as it is


class Steps(NamedTuple):
    """Steps from the least number to the largest: counted in `bits`, and none longer than `longest`."""

    bits: int
    longest: float


STEPS = {
    "means": Steps(16, 2e-4),  # m; a pixel of a laboratory rig sees millimetres
    "drifts": Steps(8, 4e-4),  # m per clip, so .1 mm at its ends
    "quats_wxyz": Steps(8, 0.01),  # a degree is .009 of a unit quaternion
    "log_scales": Steps(8, 0.05),
    "log_durations": Steps(8, 0.05),
    "opacity_logits": Steps(8, 0.1),
}


def stored(name: str, tensor: Tensor) -> Tensor | dict[str, Tensor]:
    """Return a tensor by its name as it is stored: in whole steps or fewer bits, if it fits in them.

    What was stored before and is stored again is the same. Quaternions keep their direction, not their length.
    """
    kind = name.rpartition(".")[2]
    if not tensor.is_floating_point():
        return tensor.to(next(narrow for narrow in (torch.int8, torch.int16, torch.int32) if _fits(tensor, narrow)))
    if kind in PRECISE:
        return tensor
    values = _of_unit_length(tensor) if kind == "quats_wxyz" else tensor
    if (steps := STEPS.get(kind)) and (kept := _in_steps(values, steps)):
        return kept
    return tensor if kind == "means" else values.clamp(-HALF_MAX, HALF_MAX).half()


def restored(kept: Any) -> Tensor:
    """Return the tensor that was stored, in float32 or int64; what is in steps is off by half a step at most."""
    if isinstance(kept, dict):
        whole = kept["bytes"].float() if "bytes" in kept else kept["steps"].float() + MIDDLE
        return kept["least"] + whole * kept["step"]
    return kept.float() if kept.is_floating_point() else kept.long()


def _fits(numbers: Tensor, narrow: torch.dtype) -> bool:
    return not numbers.numel() or int(numbers.abs().max()) <= torch.iinfo(narrow).max


def _of_unit_length(quats: Tensor) -> Tensor:
    length = quats.norm(dim=-1, keepdim=True)
    return torch.where((length - 1).abs() <= NEARLY_UNIT, quats, torch.nn.functional.normalize(quats, dim=-1))


def _in_steps(values: Tensor, steps: Steps) -> dict[str, Tensor] | None:
    """Return values [N, ...] as whole steps; None for none, where steps would be too long, or one is not finite."""
    if not len(values):
        return None
    least, most = values.amin(dim=0), values.amax(dim=0)
    count = 2**steps.bits - 1
    step = ((most - least) / count).clamp_min(torch.finfo(torch.float32).tiny)
    if not bool((step <= steps.longest).all()):  # also where one is NaN
        return None
    whole = ((values - least) / step).round().clamp(0, count)
    kept = {"bytes": whole.to(torch.uint8)} if steps.bits == 8 else {"steps": (whole - MIDDLE).to(torch.int16)}
    return {"least": least, "step": step, **kept}
