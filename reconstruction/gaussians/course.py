"""Where Gaussians are and how dense at one instant: one native pass forward and one back, and the same in torch.

Letters: N still, M moving, K the order of the motion, s = instant - instants, all in clips. A moving Gaussian is at
`means + sum_k coefficients[k - 1] * s^k`, k = 1..K, and its opacity is gated by exp(-(s / duration)^2 / 2).
"""

from __future__ import annotations

import ctypes
import math
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from reconstruction.native import library

LEAST_DURATION = 1e-3  # clips; shorter is a flash between two planes
MOST_DURATION = 1e3  # clips; longer is always there
FARTHEST = 1e6  # clips; beyond it nothing is seen, and a cube would overflow
ORDERS = 3


class Course(NamedTuple):
    """What moves: `coefficients` [M, 3] of s, s^2, s^3 (three at most, none is standing still), m per clip^k."""

    means: Tensor  # [M, 3]
    opacity_logits: Tensor  # [M]
    instants: Tensor  # [M]
    log_durations: Tensor  # [M]
    coefficients: tuple[Tensor, ...]


def evaluated(means: Tensor, opacity_logits: Tensor, course: Course, instant: float) -> tuple[Tensor, Tensor]:
    """Means [N + M, 3] and opacities [N + M] at `instant`, held within FARTHEST; of the still Gaussians first.

    Native for float32 on the CPU up to cubic motion, the reference elsewhere; differentiable in every tensor.
    """
    instant = min(max(instant, -FARTHEST), FARTHEST)
    tensors = (means, opacity_logits, *course[:4], *course.coefficients)
    native = all(t.dtype == torch.float32 and t.device.type == "cpu" for t in tensors)
    if not native or len(course.coefficients) > ORDERS:
        return evaluated_reference(means, opacity_logits, course, instant)
    return _Evaluate.apply(instant, *tensors)


def evaluated_reference(means: Tensor, opacity_logits: Tensor, course: Course, instant: float) -> tuple[Tensor, Tensor]:
    """`evaluated` in torch, for any float type and any order."""
    since = instant - course.instants
    offsets = torch.zeros_like(course.means)
    for coefficients in reversed(course.coefficients):
        offsets = (offsets + coefficients) * since[:, None]
    durations = course.log_durations.clamp(math.log(LEAST_DURATION), math.log(MOST_DURATION)).exp()
    gate = torch.exp(-0.5 * (since / durations).square())
    return (
        torch.cat([means, course.means + offsets]),
        torch.cat([opacity_logits.sigmoid(), course.opacity_logits.sigmoid() * gate]),
    )


class _Motion(ctypes.Structure):
    _fields_ = (
        ("tensors", ctypes.c_void_p * (ORDERS + 2)),
        ("counts", ctypes.c_int64 * 2),
        ("numbers", ctypes.c_double * 3),
    )


def _pointers(tensors: list[Tensor | None]) -> ctypes.Array:
    return (ctypes.c_void_p * len(tensors))(*(None if t is None else t.data_ptr() for t in tensors))


def _motion(instant: float, tensors: tuple[Tensor, ...]) -> _Motion:
    means, _, moving, _, instants, log_durations, *coefficients = tensors
    padded = [*coefficients, *[None] * (ORDERS - len(coefficients))]
    return _Motion(
        _pointers([*padded, instants, log_durations]),
        (ctypes.c_int64 * 2)(len(means), len(moving)),
        (ctypes.c_double * 3)(instant, math.log(LEAST_DURATION), math.log(MOST_DURATION)),
    )


class _Evaluate(Function):
    @staticmethod
    def forward(ctx: Any, instant: float, *tensors: Tensor) -> tuple[Tensor, Tensor]:
        tensors = tuple(t.contiguous() for t in tensors)
        count = len(tensors[0]) + len(tensors[2])
        means, opacities = torch.empty(count, 3), torch.empty(count)
        library().motion_forward(
            ctypes.byref(_motion(instant, tensors)),
            _pointers(list(tensors[:4])),
            *(ctypes.c_void_p(t.data_ptr()) for t in (means, opacities)),
            torch.get_num_threads(),
        )
        ctx.save_for_backward(*tensors)
        ctx.instant = instant
        return means, opacities

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, to_means: Tensor, to_opacities: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        tensors = ctx.saved_tensors
        to_means, to_opacities = to_means.contiguous(), to_opacities.contiguous()
        still, logits = len(tensors[0]), torch.empty_like(to_opacities)
        instants, durations, *coefficients = (torch.empty_like(t) for t in tensors[4:])
        padded = [*coefficients, *[None] * (ORDERS - len(coefficients))]
        library().motion_backward(
            ctypes.byref(_motion(ctx.instant, tensors)),
            _pointers(list(tensors[:4])),
            *(ctypes.c_void_p(t.data_ptr()) for t in (to_means, to_opacities)),
            _pointers([*padded, instants, durations, logits]),
            torch.get_num_threads(),
        )
        through = (to_means[:still], logits[:still], to_means[still:], logits[still:])
        return (None, *through, instants, durations, *coefficients)
