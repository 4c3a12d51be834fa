"""A deformable convolution out of torch alone: samples where the offsets say, then an ordinary product of matrices.

Slower than a fused kernel, for it keeps nine samples of every value, but it runs wherever torch does.
Source: Zhu et al., "Deformable ConvNets v2", CVPR 2019, without its modulation.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional


class DeformableConvolution(nn.Module):
    """A 3x3 convolution of [N, C, H, W] whose taps lie where `guide` [N, C, H, W] puts them, in 8 groups."""

    groups = 8

    def __init__(self, channels: int, guide_channels: int) -> None:
        super().__init__()
        self.taps = nn.Conv2d(channels, channels, 3)
        self.offsets = nn.Conv2d(guide_channels, 2 * 9 * self.groups, 3, padding=1)
        nn.init.zeros_(self.offsets.weight)  # at first an ordinary convolution
        nn.init.zeros_(self.offsets.bias)  # pyright: ignore[reportArgumentType]

    def forward(self, x: Tensor, guide: Tensor) -> Tensor:
        """Return the convolution of `x` [N, C, H, W] with taps moved as the `guide` says."""
        return deformed(x, self.offsets(guide), self.taps.weight, self.taps.bias)


def deformed(x: Tensor, offsets: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """Convolve `x` [N, C, H, W] by `weight` [D, C, 3, 3] at its nine taps moved by `offsets`, to [N, D, H, W]; zero
    outside.

    `offsets` [N, G * 9 * 2, H, W] are pixels (down, right) of each tap, for G equal groups of the channels.
    """
    batch, channels, height, width = x.shape
    groups = offsets.shape[1] // 18
    moves = offsets.reshape(batch * groups, 9, 2, height, width)
    rows = torch.arange(height, device=x.device, dtype=x.dtype)[:, None]
    columns = torch.arange(width, device=x.device, dtype=x.dtype)[None, :]
    tap = torch.arange(9, device=x.device)[:, None, None]
    y, z = rows + (tap // 3 - 1) + moves[:, :, 0], columns + (tap % 3 - 1) + moves[:, :, 1]
    grid = torch.stack([(2 * z + 1) / width - 1, (2 * y + 1) / height - 1], dim=-1)
    grouped = x.reshape(batch * groups, channels // groups, height, width)
    below = grid.reshape(batch * groups, 9 * height, width, 2)  # the taps' samples one below another
    sampled = functional.grid_sample(grouped, below, mode="bilinear", padding_mode="zeros", align_corners=False)
    gathered = sampled.reshape(batch, channels * 9, height, width)
    return functional.conv2d(gathered, weight.reshape(len(weight), channels * 9, 1, 1), bias)
