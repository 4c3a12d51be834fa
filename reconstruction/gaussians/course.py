"""Positions and opacities of Gaussians at one instant: one native pass forward and one back, and the same in torch.

Letters: N still, M moving, K the order of the motion, s = instant - instants, all in clips. A moving Gaussian is at
`means + sum_k coefficients[k - 1] * s^k`, k = 1..K, and its opacity is gated by exp(-(s / duration)^2 / 2).
"""

import ctypes
import math
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from acquisition.native import Address
from reconstruction.native import Addresses, Int, addresses, fits, kernel

LEAST_DURATION = 1e-3  # clips; a shorter flash falls between two planes
MOST_DURATION = 1e3  # clips; as good as for ever
FARTHEST = 1e6  # clips from the start; nothing is seen beyond, and a cube would overflow
ORDERS = 3


class Course(NamedTuple):
    """Motion of M Gaussians; `coefficients` are those of s, s^2, s^3, or fewer: without any, nothing moves."""

    means: Tensor  # [M, 3] m
    opacity_logits: Tensor  # [M]
    instants: Tensor  # [M] clips
    log_durations: Tensor  # [M] log clips
    coefficients: tuple[Tensor, ...]  # [M, 3] m per clip^k each


def evaluated(means: Tensor, opacity_logits: Tensor, course: Course, instant: float) -> tuple[Tensor, Tensor]:
    """Return positions [N + M, 3] in m and opacities [N + M] at `instant` in clips, held within FARTHEST.

    `means` [N, 3] and `opacity_logits` [N] are of the still Gaussians, which come first. Differentiable in every
    tensor; native for float32 on the CPU up to cubic motion, else the reference.
    """
    instant = min(max(instant, -FARTHEST), FARTHEST)
    tensors = (means, opacity_logits, *course[:4], *course.coefficients)
    if not fits(*tensors) or len(course.coefficients) > ORDERS:
        return evaluated_reference(means, opacity_logits, course, instant)
    return _Evaluate.apply(instant, *tensors)


def evaluated_reference(means: Tensor, opacity_logits: Tensor, course: Course, instant: float) -> tuple[Tensor, Tensor]:
    """Compute `evaluated` in torch, for any float type and any order."""
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


_MOTION = (ctypes.POINTER(_Motion), Addresses, Address, Address)
_forward = kernel("motion_forward", *_MOTION, Int)
_backward = kernel("motion_backward", *_MOTION, Addresses, Int)


def _padded(coefficients: list[Tensor]) -> list[Tensor | None]:
    return [*coefficients, *[None] * (ORDERS - len(coefficients))]


def _motion(instant: float, tensors: tuple[Tensor, ...]) -> _Motion:
    means, _, moving, _, instants, log_durations, *coefficients = tensors
    return _Motion(
        addresses(*_padded(coefficients), instants, log_durations),
        (ctypes.c_int64 * 2)(len(means), len(moving)),
        (ctypes.c_double * 3)(instant, math.log(LEAST_DURATION), math.log(MOST_DURATION)),
    )


class _Evaluate(Function):
    @staticmethod
    def forward(ctx: Any, instant: float, *tensors: Tensor) -> tuple[Tensor, Tensor]:
        tensors = tuple(t.contiguous() for t in tensors)
        count = len(tensors[0]) + len(tensors[2])
        means, opacities = torch.empty(count, 3), torch.empty(count)
        _forward(_motion(instant, tensors), addresses(*tensors[:4]), means, opacities, torch.get_num_threads())
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
        out = addresses(*_padded(coefficients), instants, durations, logits)
        given = (_motion(ctx.instant, tensors), addresses(*tensors[:4]), to_means, to_opacities)
        _backward(*given, out, torch.get_num_threads())
        through = (to_means[:still], logits[:still], to_means[still:], logits[still:])
        return (None, *through, instants, durations, *coefficients)
