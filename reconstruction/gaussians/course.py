"""Positions and opacities of Gaussians at one instant: one native pass forward and one back, and the same in torch.

Letters: M Gaussians, K the order of the motion, s = instant - instants, all in clips. A Gaussian is at
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
from reconstruction.native import Addresses, Int, addresses, fits, kernel, threads

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


def evaluated(course: Course, instant: float) -> tuple[Tensor, Tensor]:
    """Return positions [M, 3] in m and opacities [M] at `instant` in clips, held within FARTHEST.

    Differentiable in every tensor; native for float32 on the CPU up to cubic motion, else the reference.
    """
    instant = min(max(instant, -FARTHEST), FARTHEST)
    tensors = (*course[:4], *course.coefficients)
    if not fits(*tensors) or len(course.coefficients) > ORDERS:
        return evaluated_reference(course, instant)
    return _Evaluate.apply(instant, *tensors)


def evaluated_reference(course: Course, instant: float) -> tuple[Tensor, Tensor]:
    """Compute `evaluated` in torch, for any float type and any order."""
    since = instant - course.instants
    offsets = torch.zeros_like(course.means)
    for coefficients in reversed(course.coefficients):
        offsets = (offsets + coefficients) * since[:, None]
    durations = course.log_durations.clamp(math.log(LEAST_DURATION), math.log(MOST_DURATION)).exp()
    gate = torch.exp(-0.5 * (since / durations).square())
    return course.means + offsets, course.opacity_logits.sigmoid() * gate


class _Motion(ctypes.Structure):
    _fields_ = (
        ("tensors", ctypes.c_void_p * (4 + ORDERS)),
        ("count", ctypes.c_int64),
        ("numbers", ctypes.c_double * 3),
    )


_forward = kernel("motion_forward", ctypes.POINTER(_Motion), Address, Address, Int)
_backward = kernel("motion_backward", ctypes.POINTER(_Motion), Address, Address, Addresses, Int)


def _motion(instant: float, tensors: tuple[Tensor, ...]) -> _Motion:
    missing = [None] * (4 + ORDERS - len(tensors))
    numbers = (ctypes.c_double * 3)(instant, math.log(LEAST_DURATION), math.log(MOST_DURATION))
    return _Motion(addresses(*tensors, *missing), len(tensors[0]), numbers)


class _Evaluate(Function):
    @staticmethod
    def forward(ctx: Any, instant: float, *tensors: Tensor) -> tuple[Tensor, Tensor]:
        tensors = tuple(t.contiguous() for t in tensors)
        means, opacities = torch.empty_like(tensors[0]), torch.empty_like(tensors[1])
        _forward(_motion(instant, tensors), means, opacities, threads())
        ctx.save_for_backward(*tensors)
        ctx.instant = instant
        return means, opacities

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, to_means: Tensor, to_opacities: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        tensors = ctx.saved_tensors
        to_means, to_opacities = to_means.contiguous(), to_opacities.contiguous()
        found = [torch.empty_like(t) for t in tensors[1:]]
        out = addresses(*found, *[None] * (4 + ORDERS - len(tensors)))
        _backward(_motion(ctx.instant, tensors), to_means, to_opacities, out, threads())
        return (None, to_means, *found)
