"""Quaternions (w, x, y, z) in torch, differentiable. NaN stays NaN everywhere, and the renderer refuses it."""

import torch
from torch import Tensor


def unit(quats_wxyz: Tensor) -> Tensor:
    """Return quaternions [..., 4] of any length at length one; no rotation where all four numbers are zero."""
    largest = quats_wxyz.detach().abs().amax(dim=-1, keepdim=True)
    some = largest != 0  # true for NaN, which `largest > 0` would turn into no rotation
    # Scaled first, so that 1e20 and 1e-20 survive the squares.
    scaled = torch.where(some, quats_wxyz / torch.where(some, largest, 1), quats_wxyz.new_tensor([1.0, 0, 0, 0]))
    return scaled / scaled.norm(dim=-1, keepdim=True)


def matrices(quats_wxyz: Tensor) -> Tensor:
    """Return the rotation matrices [N, 3, 3] of quaternions [N, 4] of any length; the identity where all are zero."""
    w, x, y, z = unit(quats_wxyz).unbind(-1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def rotated(quats_wxyz: Tensor, vectors: Tensor) -> Tensor:
    """Return `vectors` [M, 3] turned by unit quaternions [M, 4]."""
    real, axis = quats_wxyz[:, :1], quats_wxyz[:, 1:]
    across = 2 * torch.linalg.cross(axis, vectors)
    return vectors + real * across + torch.linalg.cross(axis, across)


def product(left: Tensor, right: Tensor) -> Tensor:
    """Return Hamilton's product [M, 4] of quaternions [M, 4] each: the rotation `right`, then `left`."""
    a, u = left[:, :1], left[:, 1:]
    b, v = right[:, :1], right[:, 1:]
    real = a * b - (u * v).sum(-1, keepdim=True)
    return torch.cat([real, a * v + b * u + torch.linalg.cross(u, v)], dim=-1)
