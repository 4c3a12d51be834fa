"""Structural similarity of two images, as a loss: the native kernels and their reference in torch.

Source: Wang et al., "Image quality assessment", IEEE TIP 2004, with a Gaussian window of 1.5 px cut to 11 taps and the
population covariance. At the border the window is cut and normalised again, so that the map has the image's size; from
5 px inside on it is the map that scikit-image computes.
"""

import math
from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from acquisition.native import Address
from reconstruction.errors import ReconstructionError
from reconstruction.native import Float, Int, fits, kernel

SIGMA_PX = 1.5
REACH_PX = 5


def ssim_map(image: Tensor, target: Tensor, data_range: float) -> Tensor:
    """Return the similarity [H, W] of `image` and `target` [H, W] around each pixel: 1 where they agree.

    `data_range` is in the images' own unit. Differentiable in `image` alone; native for float32 on the CPU, else the
    reference. Raises ReconstructionError for shapes that differ or a data range that is not positive.
    """
    if image.ndim != 2 or image.shape != target.shape or image.numel() == 0:
        found = f"found images of shapes {tuple(image.shape)} and {tuple(target.shape)}"
        raise ReconstructionError(found, "the same (H, W)")
    if not (math.isfinite(data_range) and data_range > 0):
        raise ReconstructionError(f"found the data range {data_range}", "a positive number")
    if not fits(image, target):
        return ssim_map_reference(image, target, data_range)
    return _Similarity.apply(image, target, data_range)


def _constants(data_range: float) -> tuple[float, float]:
    return (0.01 * data_range) ** 2, (0.03 * data_range) ** 2


def windowed_means(images: Tensor) -> Tensor:
    """Return the Gaussian-weighted means [B, H, W] around each pixel of images [B, H, W]."""
    offsets = torch.arange(-REACH_PX, REACH_PX + 1, dtype=images.dtype, device=images.device)
    weights = torch.exp(-0.5 * (offsets / SIGMA_PX) ** 2)
    window = weights / weights.sum()

    def filtered(x: Tensor) -> Tensor:
        x = torch.nn.functional.conv2d(x[:, None], window[None, None, None, :], padding=(0, REACH_PX))
        return torch.nn.functional.conv2d(x, window[None, None, :, None], padding=(REACH_PX, 0))[:, 0]

    return filtered(images) / filtered(torch.ones_like(images[:1]))


def ssim_map_reference(image: Tensor, target: Tensor, data_range: float) -> Tensor:
    """Compute `ssim_map` in torch, for any float type."""
    x, y = image, target.detach()
    mean_x, mean_y, mean_squares, mean_product = windowed_means(torch.stack([x, y, x * x + y * y, x * y]))
    c1, c2 = _constants(data_range)
    squares, product = mean_x * mean_x + mean_y * mean_y, mean_x * mean_y
    variances = mean_squares - squares
    covariance = mean_product - product
    return (2 * product + c1) * (2 * covariance + c2) / ((squares + c1) * (variances + c2))


_IMAGE, _SIZE = (Address, Address), (Int, Int)
_forward = kernel("ssim_forward", *_IMAGE, *_SIZE, Float, Float, Address, Address, Address, Int)
_backward = kernel("ssim_backward", *_IMAGE, Address, Address, *_SIZE, Address, Address, Int)


class _Similarity(Function):
    @staticmethod
    def forward(ctx: Any, image: Tensor, target: Tensor, data_range: float) -> Tensor:
        image, target = image.contiguous(), target.contiguous()
        height, width = image.shape
        similarity, slopes = torch.empty_like(image), image.new_empty(3, height, width)
        constants, scratch = _constants(data_range), image.new_empty(4, height, width)
        threads = torch.get_num_threads()
        _forward(image, target, width, height, *constants, similarity, slopes, scratch, threads)
        ctx.save_for_backward(image, target, slopes)
        return similarity

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        image, target, slopes = ctx.saved_tensors
        height, width = image.shape
        out, scratch = torch.empty_like(image), image.new_empty(3, height, width)
        given = (image, target, gradient.contiguous(), slopes, width, height)
        _backward(*given, out, scratch, torch.get_num_threads())
        return out, None, None
