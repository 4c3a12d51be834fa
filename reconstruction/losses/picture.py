"""The loss of one render against its target picture, over all of it or some cells: native, and the same in torch.

A picture is cut into cells of CELL_PX x CELL_PX pixels, row by row, those at the right and the lower border smaller.
Letters: H rows, W columns, c rows of d cells. Each pixel has the loss

    shared * ((1 - ssim) |x - y| / white + ssim (1 - S) + solid (1 - alpha))
    + solid * empty * (2 alpha - 1) + hold * min(|depth / known - alpha|, most)

of the render x, its target y and their structural similarity S. Cells are weighed, and the sum is divided by H W.
"""

import ctypes
import functools
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

CELL_PX = 32
_WIDE, _LINE = 42, 48  # rows, and floats of a row, that the kernel keeps of a cell and what its windows reach


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
    """What a render is compared with: a `picture` [H, W] and what is known of its pixels.

    `empty` [H, W]: 1 where nothing is, else 0; None where something is everywhere. `inverse_depth` [H, W]: 1/m, 0 where
    no depth is known; None where none is. `shared`: factor of the first part of the loss.
    """

    picture: Tensor
    empty: Tensor | None = None
    inverse_depth: Tensor | None = None
    shared: float = 1.0


@dataclass(frozen=True, eq=False)
class Compared:
    """The outcome: the `loss`, and by cell [c, d] the means over its pixels of loss and squared error, unweighed.

    `sizes` [c, d]: the cells' numbers of pixels.
    """

    loss: Tensor
    losses: Tensor
    sizes: Tensor
    squares: Tensor

    def mean_square(self, weights: Tensor | None = None) -> float:
        """Return the mean squared error over all pixels, each cell times its weight [c, d]."""
        return float((self.squares * self.sizes * (1 if weights is None else weights)).sum() / self.sizes.sum())


def inverse_depth(depth: NDArray[np.float32]) -> Tensor:
    """Return 1 / depth [H, W] in 1/m of a map in m, 0 where it has no depth: NaN, infinity, or none in front."""
    known = torch.from_numpy(np.ascontiguousarray(depth))
    return torch.where(known.isfinite() & (known > 0), 1 / known, 0)


def cells_of(height: int, width: int) -> tuple[int, int]:
    """Return the numbers of rows and columns of cells of a picture."""
    return -(-height // CELL_PX), -(-width // CELL_PX)


@functools.cache
def cell_sizes(height: int, width: int) -> Tensor:
    """Return the number of pixels of each cell [c, d]."""
    down, across = (
        torch.tensor([min(CELL_PX, size - first) for first in range(0, size, CELL_PX)]) for size in (height, width)
    )
    return down[:, None] * across[None, :]


def by_pixel(cells: Tensor, height: int, width: int) -> Tensor:
    """Return the values [H, W] of the cells [c, d] that pixels lie in."""
    return cells.repeat_interleave(CELL_PX, 0)[:height].repeat_interleave(CELL_PX, 1)[:, :width]


def picture_loss(
    seen: tuple[Tensor, Tensor, Tensor], target: Target, loss: PictureLoss, weights: Tensor | None = None
) -> Compared:
    """Compare a render's light, depth and alpha, [H, W] each, with its target.

    `weights` [c, d] are those of the cells, 1 where None; of a cell of weight 0 and beyond 5 px around the others the
    render is not looked at. Differentiable in `seen`; native for float32 on the CPU, else the reference. Raises
    ReconstructionError for shapes that do not fit or a data range that is not positive.
    """
    shape = target.picture.shape
    if len(shape) != 2 or not target.picture.numel() or any(image.shape != shape for image in seen):
        found = ", ".join(str(tuple(image.shape)) for image in (target.picture, *seen))
        raise ReconstructionError(f"found pictures of shapes {found}", "the same (H, W)")
    if weights is not None and weights.shape != cells_of(*shape):
        raise ReconstructionError(f"found weights of shape {tuple(weights.shape)}", str(cells_of(*shape)))
    if not (math.isfinite(loss.white) and loss.white > 0):
        raise ReconstructionError(f"found the data range {loss.white}", "a positive number")
    if not fits(*seen, target.picture):
        return picture_loss_reference(seen, target, loss, weights)
    weights = torch.ones(cells_of(*shape)) if weights is None else weights.float().contiguous()
    total, losses, squares = _Compare.apply(*seen, target, loss, weights)
    sizes = cell_sizes(*shape)
    return Compared(total, losses / sizes, sizes, squares / sizes)


def picture_loss_reference(
    seen: tuple[Tensor, Tensor, Tensor], target: Target, loss: PictureLoss, weights: Tensor | None = None
) -> Compared:
    """Compute `picture_loss` in torch, for any float type."""
    (light, depth, alpha), picture = seen, target.picture
    height, width = picture.shape
    alike = ssim_map(light, picture, loss.white)
    gap = light - picture
    own = (1 - loss.ssim) * gap.abs() / loss.white + loss.ssim * (1 - alike) + loss.solid * (1 - alpha)
    values = target.shared * own
    if target.empty is not None:
        values = values + loss.solid * target.empty * (2 * alpha - 1)
    if target.inverse_depth is not None:
        off = (depth * target.inverse_depth - alpha).abs().clamp_max(loss.most)
        values = values + loss.hold * torch.where(target.inverse_depth > 0, off, 0)
    scale = 1 if weights is None else by_pixel(weights, height, width)
    rows = torch.arange(height) // CELL_PX
    cell = rows[:, None] * cells_of(height, width)[1] + torch.arange(width) // CELL_PX
    sums = [_by_cell(v.detach(), cell, (height, width)) for v in (values, gap.square())]
    sizes = cell_sizes(height, width)
    return Compared((scale * values).mean(), sums[0] / sizes, sizes, sums[1] / sizes)


def _by_cell(values: Tensor, cell: Tensor, size: tuple[int, int]) -> Tensor:
    sums = torch.zeros(cells_of(*size), dtype=torch.float64).flatten()
    sums.index_add_(0, cell.flatten(), values.flatten().double())
    return sums.view(cells_of(*size))


class _Picture(ctypes.Structure):
    _fields_ = (
        ("tensors", ctypes.c_void_p * 13),
        ("numbers", ctypes.c_double * 8),
        ("width", ctypes.c_int32),
        ("height", ctypes.c_int32),
    )


_kernel = kernel("picture_loss", ctypes.POINTER(_Picture), Int)


class _Compare(Function):
    @staticmethod
    def forward(
        ctx: Any, light: Tensor, depth: Tensor, alpha: Tensor, target: Target, loss: PictureLoss, weights: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        seen = tuple(image.contiguous() for image in (light, depth, alpha))
        given = [None if t is None else t.contiguous() for t in (target.picture, target.empty, target.inverse_depth)]
        gradients, (height, width) = tuple(torch.empty_like(image) for image in seen), light.shape
        losses, squares = (torch.empty(weights.shape, dtype=torch.float64) for _ in range(2))
        scratch = torch.empty(weights.numel(), _WIDE, _LINE)
        pointers = addresses(*seen, *given, weights, *gradients, losses, squares, scratch)
        parts = (loss.white, loss.ssim, loss.solid, target.shared, loss.hold, loss.most)
        numbers = (ctypes.c_double * 8)(*parts, *similarity_constants(loss.white))
        _kernel(_Picture(pointers, numbers, width, height), threads())
        ctx.save_for_backward(*gradients)
        total = ((losses * weights).sum() / (height * width)).float()
        ctx.mark_non_differentiable(losses, squares)
        return total, losses, squares

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor, *_: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        by = ctx.saved_tensors if gradient == 1 else [gradient * image for image in ctx.saved_tensors]
        return (*by, None, None, None)
