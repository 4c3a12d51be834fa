"""What rides on rigid bodies at one instant: one native pass forward and one back, and the same in torch.

Letters: A riders, K bodies. Quaternions are wxyz; those of bodies are unit.
"""

from __future__ import annotations

import ctypes
from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from reconstruction.native import library


def carried(means: Tensor, quats: Tensor, bodies: Tensor, body_quats: Tensor, centers: Tensor) -> tuple[Tensor, Tensor]:
    """Places [A, 3] and quaternions [A, 4] in the rig frame of riders given in the frames of their `bodies` [A].

    Native for float32 on the CPU, the reference elsewhere; differentiable in everything but `bodies`.
    """
    tensors = (means, quats, body_quats, centers)
    if not all(t.dtype == torch.float32 and t.device.type == "cpu" for t in tensors):
        return carried_reference(means, quats, bodies, body_quats, centers)
    return _Carry.apply(*tensors, bodies)


def carried_reference(
    means: Tensor, quats: Tensor, bodies: Tensor, body_quats: Tensor, centers: Tensor
) -> tuple[Tensor, Tensor]:
    """`carried` in torch, for any float type."""
    turns = body_quats[bodies]
    return rotated(turns, means) + centers[bodies], product(turns, quats)


def rotated(quats_wxyz: Tensor, vectors: Tensor) -> Tensor:
    """`vectors` [M, 3] turned by unit quaternions [M, 4]."""
    real, axis = quats_wxyz[:, :1], quats_wxyz[:, 1:]
    across = 2 * torch.linalg.cross(axis, vectors)
    return vectors + real * across + torch.linalg.cross(axis, across)


def product(left: Tensor, right: Tensor) -> Tensor:
    """Hamilton's product [M, 4] of quaternions wxyz: `right` first, then `left`."""
    a, u = left[:, :1], left[:, 1:]
    b, v = right[:, :1], right[:, 1:]
    real = a * b - (u * v).sum(-1, keepdim=True)
    return torch.cat([real, a * v + b * u + torch.linalg.cross(u, v)], dim=-1)


class _Riders(ctypes.Structure):
    _fields_ = (("tensors", ctypes.c_void_p * 5), ("counts", ctypes.c_int64 * 2))


def _riders(means: Tensor, quats: Tensor, body_quats: Tensor, centers: Tensor, bodies: Tensor) -> _Riders:
    pointers = (t.data_ptr() for t in (means, quats, bodies, body_quats, centers))
    return _Riders((ctypes.c_void_p * 5)(*pointers), (ctypes.c_int64 * 2)(len(means), len(body_quats)))


def _pointers(*tensors: Tensor) -> list[ctypes.c_void_p]:
    return [ctypes.c_void_p(t.data_ptr()) for t in tensors]


class _Carry(Function):
    @staticmethod
    def forward(ctx: Any, *tensors: Tensor) -> tuple[Tensor, Tensor]:
        tensors = tuple(t.contiguous() for t in tensors)
        means, quats = torch.empty_like(tensors[0]), torch.empty_like(tensors[1])
        library().ride_forward(
            ctypes.byref(_riders(*tensors)), *_pointers(means, quats), ctypes.c_int32(torch.get_num_threads())
        )
        ctx.save_for_backward(*tensors)
        return means, quats

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, to_means: Tensor, to_quats: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        tensors = ctx.saved_tensors
        to_means, to_quats = to_means.contiguous(), to_quats.contiguous()
        means, quats = torch.empty_like(to_means), torch.empty_like(to_quats)
        poses = to_means.new_empty(len(tensors[2]), 7)
        library().ride_backward(
            ctypes.byref(_riders(*tensors)),
            *_pointers(to_means, to_quats, means, quats, poses),
            ctypes.c_int32(torch.get_num_threads()),
        )
        return means, quats, poses[:, :4], poses[:, 4:], None
