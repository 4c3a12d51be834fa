"""Gaussians carried by rigid bodies at one instant: one native pass forward and one back, and the same in torch.

Letters: A riders, K bodies. Quaternions are (w, x, y, z); those of bodies are unit.
"""

import ctypes
from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from acquisition.native import Address
from reconstruction.native import Int, addresses, fits, kernel, threads
from reconstruction.quaternions import product, rotated


def carried(means: Tensor, quats: Tensor, bodies: Tensor, body_quats: Tensor, centers: Tensor) -> tuple[Tensor, Tensor]:
    """Return positions [A, 3] in m and quaternions [A, 4] of riders in the rig frame.

    `means` [A, 3] in m and `quats` [A, 4] are in the frame of the rider's body; `bodies` [A] int64 says which one that
    is; `body_quats` [K, 4] and `centers` [K, 3] in m are the poses of the bodies in the rig. Differentiable in all but
    `bodies`; native for float32 on the CPU, else the reference.
    """
    tensors = (means, quats, body_quats, centers)
    if not fits(*tensors):
        return carried_reference(means, quats, bodies, body_quats, centers)
    return _Carry.apply(*tensors, bodies)


def carried_reference(
    means: Tensor, quats: Tensor, bodies: Tensor, body_quats: Tensor, centers: Tensor
) -> tuple[Tensor, Tensor]:
    """Compute `carried` in torch, for any float type."""
    turns = body_quats[bodies]
    return rotated(turns, means) + centers[bodies], product(turns, quats)


class _Riders(ctypes.Structure):
    _fields_ = (("tensors", ctypes.c_void_p * 5), ("counts", ctypes.c_int64 * 2))


_forward = kernel("ride_forward", ctypes.POINTER(_Riders), Address, Address, Int)
_backward = kernel("ride_backward", ctypes.POINTER(_Riders), *[Address] * 5, Int)


def _riders(means: Tensor, quats: Tensor, body_quats: Tensor, centers: Tensor, bodies: Tensor) -> _Riders:
    counts = (ctypes.c_int64 * 2)(len(means), len(body_quats))
    return _Riders(addresses(means, quats, bodies, body_quats, centers), counts)


class _Carry(Function):
    @staticmethod
    def forward(ctx: Any, *tensors: Tensor) -> tuple[Tensor, Tensor]:
        tensors = tuple(t.contiguous() for t in tensors)
        means, quats = torch.empty_like(tensors[0]), torch.empty_like(tensors[1])
        _forward(_riders(*tensors), means, quats, threads())
        ctx.save_for_backward(*tensors)
        return means, quats

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, to_means: Tensor, to_quats: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        tensors = ctx.saved_tensors
        to_means, to_quats = to_means.contiguous(), to_quats.contiguous()
        means, quats = torch.empty_like(to_means), torch.empty_like(to_quats)
        poses = to_means.new_empty(len(tensors[2]), 7)
        _backward(_riders(*tensors), to_means, to_quats, means, quats, poses, threads())
        return means, quats, poses[:, :4], poses[:, 4:], None
