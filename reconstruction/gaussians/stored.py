"""Stores tensors of a scene in as few bytes as no picture tells from more."""

from typing import Any

import torch
from torch import Tensor

PLACES = ("means",)  # kept as 16-bit steps between the least and the largest, where a step is fine enough
PRECISE = ("velocities", "accelerations", "jerks", "knot_quats", "knot_centers")  # kept in 32 bits
STEP_M = 2e-4  # largest step of a place, m; a pixel of a laboratory rig sees millimetres
STEPS, MIDDLE = 65_535, 32_768
HALF_MAX = 6e4  # within what 16 bits hold


def stored(name: str, tensor: Tensor) -> Tensor | dict[str, Tensor]:
    """Return a tensor by its name as it is stored: whole numbers and most others in 16 bits, if they fit in them."""
    kind = name.rpartition(".")[2]
    if not tensor.is_floating_point():
        fits = not tensor.numel() or int(tensor.abs().max()) < MIDDLE
        return tensor.to(torch.int16 if fits else torch.int32)
    if kind in PLACES:
        return _in_steps(tensor)
    return tensor if kind in PRECISE else tensor.clamp(-HALF_MAX, HALF_MAX).half()


def restored(kept: Any) -> Tensor:
    """Return the tensor that was stored, in float32 or int64; its places are off by half a step at most."""
    if isinstance(kept, dict):
        return kept["least"] + (kept["steps"].float() + MIDDLE) * kept["step"]
    return kept.float() if kept.is_floating_point() else kept.long()


def _in_steps(places: Tensor) -> Tensor | dict[str, Tensor]:
    """Return places [N, 3] in m as whole steps; as they are where a step would be too long, or one is not finite."""
    if not len(places):
        return places
    least, most = places.amin(dim=0), places.amax(dim=0)
    step = ((most - least) / STEPS).clamp_min(torch.finfo(torch.float32).tiny)
    if not bool((step <= STEP_M).all()):  # also where one is NaN
        return places
    steps = ((places - least) / step).round().clamp(0, STEPS) - MIDDLE
    return {"least": least, "step": step, "steps": steps.to(torch.int16)}
