"""The loss of one render against its target picture: native, and the same in torch.

Each pixel of a render x with the target y and their structural similarity S has the loss

    shared * ((1 - ssim) |x - y| / white + ssim (1 - S) + solid (1 - alpha))
    + solid * empty * (2 alpha - 1) + hold * min(|depth / known - alpha|, most)

and a picture the mean of its pixels. Letters: H rows, W columns.
"""

import ctypes
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from reconstruction.errors import ReconstructionError
from reconstruction.losses.ssim import similarity_constants, ssim_map
from reconstruction.native import Int, addresses, fits, kernel, threads

_CELL, _WIDE, _LINE = 32, 42, 48  # pixels a side of the kernel's cells, and rows and floats of a row that it keeps


@dataclass(frozen=True)
class PictureLoss:
    """The weights of the loss's parts, as the module's formula names them.

    `white`: data range, in the unit of the pictures. `ssim`: share of SSIM. `solid`: weight of light that passes
    through everything. `hold`: weight of known depths, `most`: the share of a depth beyond which they pull no more.
    """

    white: float
    ssim: float = 0.2
    solid: float = 0.02
    hold: float = 0.0
    most: float = 0.05


@dataclass(frozen=True, eq=False)
class Target:
    """The picture [H, W] that a render is compared with, and what is known of its pixels.

    `empty` [H, W]: 1 where nothing is, else 0; None where something is everywhere. `inverse_depth` [H, W]: 1/m, 0 where
    no depth is known; None where none is. `shared`: factor of the first part of the loss.
    """

    picture: Tensor
    empty: Tensor | None = None
    inverse_depth: Tensor | None = None
    shared: float = 1.0


def inverse_depth(depth: NDArray[np.float32]) -> Tensor:
    """Return 1 / depth [H, W] in 1/m of a map in m, 0 where it has no depth: NaN, infinity, or none in front."""
    known = torch.from_numpy(np.ascontiguousarray(depth))
    return torch.where(known.isfinite() & (known > 0), 1 / known, 0)


def misplaced_light(alpha: Tensor, empty: Tensor | None) -> Tensor:
    """Return the mean of the light that solid places let through and empty ones take, of alpha [..., P] in 0 to 1.

    `empty` [P]: 1 where nothing is, else 0; None where something is everywhere.
    """
    through = 1 - alpha
    return (through if empty is None else torch.where(empty > 0, alpha, through)).mean()


def picture_loss(seen: tuple[Tensor, Tensor, Tensor], target: Target, loss: PictureLoss) -> tuple[Tensor, float]:
    """Compare a render's light, depth and alpha, [H, W] each, with its target: the loss, and the mean squared error.

    Differentiable in `seen`; native for float32 on the CPU, else the reference. Raises ReconstructionError for shapes
    that do not fit or a data range that is not positive.
    """
    shape = target.picture.shape
    if len(shape) != 2 or not target.picture.numel() or any(image.shape != shape for image in seen):
        found = ", ".join(str(tuple(image.shape)) for image in (target.picture, *seen))
        raise ReconstructionError(f"found pictures of shapes {found}", "the same (H, W)")
    if not (math.isfinite(loss.white) and loss.white > 0):
        raise ReconstructionError(f"found the data range {loss.white}", "a positive number")
    if not fits(*seen, target.picture):
        return picture_loss_reference(seen, target, loss)
    total, square = _Compare.apply(*seen, target, loss)
    return total, float(square)


def picture_loss_reference(
    seen: tuple[Tensor, Tensor, Tensor], target: Target, loss: PictureLoss
) -> tuple[Tensor, float]:
    """Compute `picture_loss` in torch, for any float type."""
    (light, depth, alpha), picture = seen, target.picture
    gap = light - picture
    alike = ssim_map(light, picture, loss.white)
    own = (1 - loss.ssim) * gap.abs() / loss.white + loss.ssim * (1 - alike) + loss.solid * (1 - alpha)
    values = target.shared * own
    if target.empty is not None:
        values = values + loss.solid * target.empty * (2 * alpha - 1)
    if target.inverse_depth is not None:
        off = (depth * target.inverse_depth - alpha).abs().clamp_max(loss.most)
        values = values + loss.hold * torch.where(target.inverse_depth > 0, off, 0)
    return values.mean(), float(gap.detach().square().mean())


class _Picture(ctypes.Structure):
    _fields_ = (
        ("tensors", ctypes.c_void_p * 12),
        ("numbers", ctypes.c_double * 8),
        ("width", ctypes.c_int32),
        ("height", ctypes.c_int32),
    )


_kernel = kernel("picture_loss", ctypes.POINTER(_Picture), Int)


class _Compare(Function):
    @staticmethod
    def forward(
        ctx: Any, light: Tensor, depth: Tensor, alpha: Tensor, target: Target, loss: PictureLoss
    ) -> tuple[Tensor, Tensor]:
        seen = tuple(image.contiguous() for image in (light, depth, alpha))
        given = [None if t is None else t.contiguous() for t in (target.picture, target.empty, target.inverse_depth)]
        gradients, (height, width) = tuple(torch.empty_like(image) for image in seen), light.shape
        cells = -(-height // _CELL) * -(-width // _CELL)
        sums, scratch = torch.empty(2, cells, dtype=torch.float64), torch.empty(cells, _WIDE, _LINE)
        pointers = addresses(*seen, *given, *gradients, *sums, scratch)
        parts = (loss.white, loss.ssim, loss.solid, target.shared, loss.hold, loss.most)
        numbers = (ctypes.c_double * 8)(*parts, *similarity_constants(loss.white))
        _kernel(_Picture(pointers, numbers, width, height), threads())
        ctx.save_for_backward(*gradients)
        total, square = sums.sum(dim=1) / (height * width)
        ctx.mark_non_differentiable(square)
        return total.float(), square

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor, *_: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        by = ctx.saved_tensors if gradient == 1 else [gradient * image for image in ctx.saved_tensors]
        return (*by, None, None)
