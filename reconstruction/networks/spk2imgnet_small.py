"""The small Spk2ImgNet, which is ours: 0.2 M parameters that two cores train in an hour or two.

In the spirit of the published one (several temporal windows of the same instant, features, residual blocks, fusion),
but it sees rates between spikes instead of raw planes, 129 of them instead of 41, and its image is a choice, pixel by
pixel, among the means of eight windows, plus a correction. Half of its work is done at half the resolution. There is
no deformable alignment: at most a few pixels are crossed in the windows that matter, which its 3x3 filters reach.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from reconstruction.networks.rates import BINS, EDGES

FULL, HALF = 32, 64  # channels at the two resolutions
LEAST_SIGMA = 1e-3  # least error, as a share of the image's mean light


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions beside the identity."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first, self.second = (nn.Conv2d(channels, channels, 3, padding=1) for _ in range(2))

    def forward(self, x: Tensor) -> Tensor:
        """Map [N, C, H, W] to the same."""
        return x + self.second(functional.relu(self.first(x)))


class SmallSpk2ImgNet(nn.Module):
    """Rates [N, BINS, H, W] and the mean light [N, 1, 1, 1] to light and its standard deviation, [N, 1, H, W] each."""

    stride = 2  # H and W must be multiples
    windows: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.head = nn.Conv2d(BINS + 2, FULL, 3, padding=1)
        self.fine = ResidualBlock(FULL)
        self.down = nn.Conv2d(FULL, HALF, 2, stride=2)
        self.body = nn.Sequential(ResidualBlock(HALF), ResidualBlock(HALF))
        self.up = nn.Conv2d(HALF, 4 * FULL, 1)
        self.merged = ResidualBlock(FULL)
        self.tail = nn.Conv2d(FULL, BINS // 2 + 3, 3, padding=1)
        self.register_buffer("windows", window_means(), persistent=False)
        nn.init.zeros_(self.tail.weight)

    def forward(self, rates: Tensor, mean: Tensor) -> tuple[Tensor, Tensor]:
        """Return light and its deviation; see the class."""
        now = rates[:, BINS // 2, None]
        seen = torch.cat([rates / mean, now, now * now / mean], dim=1)  # a whole tick's share of a rate is its square
        fine = self.fine(functional.relu(self.head(seen)))
        coarse = self.body(functional.relu(self.down(fine)))
        x = self.merged(fine + functional.pixel_shuffle(self.up(coarse), 2))
        out = self.tail(functional.relu(x))
        choice = torch.softmax(out[:, :-2], dim=1)
        means = functional.conv2d(rates, self.windows)
        light = (choice * means).sum(dim=1, keepdim=True) + mean * out[:, -2, None]
        return light, mean * (LEAST_SIGMA + functional.softplus(out[:, -1, None] - 3))


def window_means() -> Tensor:
    """Return 1x1 filters [8, BINS, 1, 1] that turn bins into means of windows, the shortest first."""
    width = torch.tensor(EDGES[1:] - EDGES[:-1], dtype=torch.float32)
    offset = (torch.arange(BINS) - BINS // 2).abs()
    inside = (offset[None, :] <= torch.arange(BINS // 2 + 1)[:, None]).float() * width
    return (inside / inside.sum(dim=1, keepdim=True))[:, :, None, None]


def doubled(x: Tensor) -> Tensor:
    """Return features [N, C, H, W] at twice the size, bilinearly."""
    return functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
