"""The input of MSDI's geometry: light and its error as channels that brightness and contrast do not change.

Letters: V views, H rows and W columns at the working size, N = (H / PATCH) (W / PATCH) patches.
"""

import torch
from torch import Tensor
from torch.nn import functional

from reconstruction.networks.spk2imgnet_small import window_means

PATCH, FINE = 8, 2  # px a side at the working size: of a patch, of a cell of the fine features
WORKING_WIDTH = 200  # px; wider views are shrunk by a whole factor
CHANNELS = 5
NEIGHBOURHOOD = 15  # px whose mean and contrast are taken out
LEAST_CONTRAST = 0.06  # least contrast, as a share of the square root of the mean light


def working_factor(width: int) -> int:
    """Return the factor by which a view `width` pixels wide is shrunk."""
    return max(1, round(width / WORKING_WIDTH))


def channels(light: Tensor, sigma: Tensor, rates: Tensor, level: Tensor, factor: int) -> Tensor:
    """Return channels [V, CHANNELS, H, W] from light and sigma [V, 1, h, w], rates [V, BINS, h, w], level [V, 1, 1, 1].

    Square roots of the light at the instant and of the long mean, each as it is and with the mean and contrast of its
    surroundings taken out, and the error of the light. H and W are multiples of PATCH: the right and lower border
    repeat what is beside them, which moves no pixel.
    """
    longest = functional.conv2d(rates, window_means()[-1, None].to(rates))
    seen = torch.cat([light, longest, sigma], dim=1) / level
    seen = functional.pad(seen, (0, -seen.shape[3] % factor, 0, -seen.shape[2] % factor), mode="replicate")
    seen = functional.avg_pool2d(seen, factor) if factor > 1 else seen
    seen = functional.pad(seen, (0, -seen.shape[3] % PATCH, 0, -seen.shape[2] % PATCH), mode="replicate")
    roots = (seen[:, :2].clamp_min(0) + 1e-4).sqrt()
    return torch.cat([roots - 1, evened(roots), seen[:, 2:].clamp(0, 4)], dim=1)


def evened(image: Tensor) -> Tensor:
    """Return the image [V, C, H, W] less the mean of its surroundings, over their contrast, kept within 4."""
    reach = NEIGHBOURHOOD // 2
    padded = functional.pad(image, (reach,) * 4, mode="replicate")
    mean = functional.avg_pool2d(padded, NEIGHBOURHOOD, 1)
    square = functional.avg_pool2d(padded * padded, NEIGHBOURHOOD, 1)
    contrast = ((square - mean * mean).clamp_min(0) + LEAST_CONTRAST**2).sqrt()
    return ((image - mean) / contrast).clamp(-4, 4)


def keypoints(seen: Tensor) -> Tensor:
    """Find the fine cell of every patch where the light changes most in all directions: its centre [V, N, 2] in px.

    The smaller eigenvalue of the structure tensor (Shi and Tomasi, "Good features to track", CVPR 1994).
    """
    image = functional.avg_pool2d(seen[:, 2:3], FINE)
    padded = functional.pad(image, (1, 1, 1, 1), mode="replicate")
    dx = (padded[:, :, 1:-1, 2:] - padded[:, :, 1:-1, :-2]) / 2
    dy = (padded[:, :, 2:, 1:-1] - padded[:, :, :-2, 1:-1]) / 2
    tensor = torch.cat([dx * dx, dx * dy, dy * dy], dim=1)
    xx, xy, yy = functional.avg_pool2d(tensor, 3, 1, padding=1, count_include_pad=False).unbind(dim=1)
    least = (xx + yy) / 2 - ((xx - yy) ** 2 / 4 + xy * xy).sqrt()
    per_patch = PATCH // FINE
    _, index = functional.max_pool2d(least[:, None], per_patch, return_indices=True)
    width = image.shape[3]
    index = index.flatten(1)
    return torch.stack([index % width, index // width], dim=-1).to(seen.dtype).add(0.5).mul(FINE)


def patch_centers(size: tuple[int, int]) -> Tensor:
    """Return the centres [N, 2] in px of the patches of a view of `size` (W, H), row by row."""
    x = (torch.arange(size[0] // PATCH) + 0.5) * PATCH
    y = (torch.arange(size[1] // PATCH) + 0.5) * PATCH
    return torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1).reshape(-1, 2)
