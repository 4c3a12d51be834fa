"""Spk2ImgNet at its published size, for those who have a GPU; our reading of the paper, no weights ship.

41 planes are cut into five blocks of 13 at steps of 7. One extractor reads every block through four temporal
sub-windows (13, 11, 9 and 7 planes about its middle) that attention weighs and joins; ten residual blocks refine each
block's features; the four outer blocks are aligned to the middle one by deformable convolutions at three scales;
fusion 320 -> 192 -> 64 -> 1 makes the image. Layouts the paper leaves open (channels, attention, the offsets' layers)
are chosen to give its 3.90 M parameters; the standard deviation beside the image is ours.
Deformable convolutions are made of torch alone: samples where the offsets say, then an ordinary product of matrices.
They keep nine samples of every value and are slower than a fused kernel, but run wherever torch does.
Sources: Zhu et al., "Deformable ConvNets v2", CVPR 2019, without its modulation;
Zhao et al., "Spk2ImgNet: learning to reconstruct dynamic scene from continuous spike stream", CVPR 2021.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from reconstruction.networks.spk2imgnet_small import LEAST_SIGMA, ResidualBlock, doubled

BLOCKS, LENGTH, STEP = 5, 13, 7
SUB_WINDOWS = (13, 11, 9, 7)  # planes about the block's middle
CHANNELS, SCALES, RESIDUAL_BLOCKS = 64, 3, 10


class Extractor(nn.Module):
    """A block of planes [N, 13, H, W] to features [N, 64, H, W]."""

    def __init__(self) -> None:
        super().__init__()
        self.windows = nn.ModuleList(
            nn.Sequential(_convolution(length), nn.ReLU(), _convolution(CHANNELS)) for length in SUB_WINDOWS
        )
        joined = len(SUB_WINDOWS) * CHANNELS
        self.attention = nn.Sequential(
            nn.Conv2d(joined, CHANNELS, 1), nn.ReLU(), nn.Conv2d(CHANNELS, len(SUB_WINDOWS), 3, padding=1), nn.Sigmoid()
        )
        self.join = _convolution(joined)
        self.refine = nn.Sequential(*(ResidualBlock(CHANNELS) for _ in range(RESIDUAL_BLOCKS)))

    def forward(self, block: Tensor) -> Tensor:
        """Map a block of planes to features; see the class."""
        cut = [(LENGTH - length) // 2 for length in SUB_WINDOWS]
        seen = [window(block[:, c : LENGTH - c]) for window, c in zip(self.windows, cut, strict=True)]
        weights = self.attention(torch.cat(seen, dim=1))
        weighed = [features * weights[:, k, None] for k, features in enumerate(seen)]
        return self.refine(functional.relu(self.join(torch.cat(weighed, dim=1))))


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
    """Convolve `x` [N, C, H, W] by `weight` [D, C, 3, 3] at nine taps moved by `offsets`; zero outside.

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


class Alignment(nn.Module):
    """Features of one block moved onto those of the middle one, offsets from coarse to fine; [N, 64, H, W] both."""

    def __init__(self) -> None:
        super().__init__()
        self.down = nn.ModuleList(_convolution(CHANNELS, stride=2) for _ in range(SCALES - 1))
        self.compare = nn.ModuleList(_convolution(2 * CHANNELS) for _ in range(SCALES))
        self.refine = nn.ModuleList(_convolution(CHANNELS) for _ in range(SCALES))
        self.inherit = nn.ModuleList(_convolution(2 * CHANNELS) for _ in range(SCALES - 1))
        self.move = nn.ModuleList(DeformableConvolution(CHANNELS, CHANNELS) for _ in range(SCALES))
        self.merge = nn.ModuleList(_convolution(2 * CHANNELS) for _ in range(SCALES - 1))

    def forward(self, features: Tensor, middle: Tensor) -> Tensor:
        """Return `features` moved onto `middle`; see the class."""
        pyramid = [(features, middle)]
        for layer in self.down:
            pyramid.append((functional.relu(layer(pyramid[-1][0])), functional.relu(layer(pyramid[-1][1]))))
        guide = aligned = torch.empty(0)
        for scale in reversed(range(SCALES)):
            here, there = pyramid[scale]
            found = functional.relu(self.compare[scale](torch.cat([here, there], dim=1)))
            if scale < SCALES - 1:
                found = functional.relu(self.inherit[scale](torch.cat([found, 2 * doubled(guide)], dim=1)))
            found = functional.relu(self.refine[scale](found))
            moved = self.move[scale](here, found)
            if scale < SCALES - 1:
                moved = self.merge[scale](torch.cat([moved, doubled(aligned)], dim=1))
            guide, aligned = found, functional.relu(moved)
        return aligned


class PublishedSpk2ImgNet(nn.Module):
    """Planes [N, 41, H, W] of 0 and 1 and their mean [N, 1, 1, 1] to light and its deviation, [N, 1, H, W] each."""

    stride = 4  # H and W must be multiples

    def __init__(self) -> None:
        super().__init__()
        self.extractor = Extractor()
        self.from_past, self.from_future = Alignment(), Alignment()
        first = nn.Conv2d(BLOCKS * CHANNELS, 3 * CHANNELS, 3, padding=1)
        self.fusion = nn.Sequential(first, nn.ReLU(), _convolution(3 * CHANNELS), nn.ReLU())
        self.light = nn.Conv2d(CHANNELS, 1, 3, padding=1)
        self.spread = nn.Sequential(_convolution(CHANNELS), nn.ReLU(), nn.Conv2d(CHANNELS, 1, 3, padding=1))

    def forward(self, planes: Tensor, mean: Tensor) -> tuple[Tensor, Tensor]:
        """Return light and its deviation; see the class."""
        blocks = [self.extractor(planes[:, STEP * k : STEP * k + LENGTH]) for k in range(BLOCKS)]
        half = BLOCKS // 2
        past = [self.from_past(block, blocks[half]) for block in blocks[:half]]
        future = [self.from_future(block, blocks[half]) for block in blocks[half + 1 :]]
        aligned = [*past, blocks[half], *future]
        fused = self.fusion(torch.cat(aligned, dim=1))
        return mean + mean * self.light(fused), mean * (LEAST_SIGMA + functional.softplus(self.spread(fused) - 3))


def _convolution(channels: int, stride: int = 1) -> nn.Conv2d:
    return nn.Conv2d(channels, CHANNELS, 3, stride=stride, padding=1)
