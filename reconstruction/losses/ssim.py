"""Structural similarity of two images in torch; `picture.py` has it in its kernel, with the rest of the loss.

Source: Wang et al., "Image quality assessment", IEEE TIP 2004, with a Gaussian window of 1.5 px cut to 11 taps and the
population covariance. At the border the window is cut and normalised again, so that the map has the image's size; from
5 px inside on it is the map that scikit-image computes.
"""

import torch
from torch import Tensor

SIGMA_PX = 1.5
REACH_PX = 5


def similarity_constants(data_range: float) -> tuple[float, float]:
    """Return the two constants of the similarity, in squares of the unit of `data_range`."""
    return (0.01 * data_range) ** 2, (0.03 * data_range) ** 2


def windowed_means(images: Tensor) -> Tensor:
    """Return the Gaussian-weighted means [B, H, W] around each pixel of images [B, H, W]."""
    wide = images.double() if images.is_cuda else images  # cuDNN may keep 10 bits of float32; variances need more
    offsets = torch.arange(-REACH_PX, REACH_PX + 1, dtype=wide.dtype, device=wide.device)
    weights = torch.exp(-0.5 * (offsets / SIGMA_PX) ** 2)
    window = weights / weights.sum()

    def filtered(x: Tensor) -> Tensor:
        x = torch.nn.functional.conv2d(x[:, None], window[None, None, None, :], padding=(0, REACH_PX))
        return torch.nn.functional.conv2d(x, window[None, None, :, None], padding=(REACH_PX, 0))[:, 0]

    return (filtered(wide) / filtered(torch.ones_like(wide[:1]))).to(images.dtype)


def ssim_map(image: Tensor, target: Tensor, data_range: float) -> Tensor:
    """Return the similarity [H, W] of `image` and `target` [H, W] around each pixel: 1 where they agree.

    `data_range` is in the images' own unit. Differentiable in `image` alone, in any float type.
    """
    x, y = image, target.detach()
    mean_x, mean_y, mean_squares, mean_product = windowed_means(torch.stack([x, y, x * x + y * y, x * y]))
    c1, c2 = similarity_constants(data_range)
    squares, product = mean_x * mean_x + mean_y * mean_y, mean_x * mean_y
    variances = mean_squares - squares
    covariance = mean_product - product
    return (2 * product + c1) * (2 * covariance + c2) / ((squares + c1) * (variances + c2))
