"""From a decoder's tokens to four numbers a pixel: a point and a confidence, not yet through their exponentials.

Letters: b images, r x k patches of p x p pixels (r rows), c channels. Parameter names are the public checkpoints'.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor, nn
from torch.nn.functional import pixel_shuffle, relu

OUTPUTS = 4  # x, y, z, confidence


@dataclass(frozen=True)
class DptSizes:
    """Channels of a DPT head: of its four scales (finest first), of their fusion, and before the last layer."""

    scales: tuple[int, int, int, int] = (96, 192, 384, 768)
    fused: int = 256
    last: int = 128


def spread(tokens: Tensor, grid: tuple[int, int]) -> Tensor:
    """Return tokens [b, n, c] as an image of patches [b, c, r, k]."""
    return tokens.transpose(1, 2).unflatten(2, grid)


class LinearHead(nn.Module):
    """One linear map from the last layer's token to all pixels of its patch."""

    def __init__(self, dim: int, patch_px: int):
        super().__init__()
        self.patch_px = patch_px
        self.proj = nn.Linear(dim, OUTPUTS * patch_px**2)

    def forward(self, layers: Sequence[Tensor], grid: tuple[int, int]) -> Tensor:
        """Map layers of tokens [b, n, c] to [b, 4, H, W]."""
        return pixel_shuffle(spread(self.proj(layers[-1]), grid), self.patch_px)


_doubled = nn.Upsample(scale_factor=2, mode="bilinear", align_corners=True)


class _Residual(nn.Module):
    def __init__(self, dim: int):
        super().__init__()
        self.conv1, self.conv2 = (nn.Conv2d(dim, dim, 3, padding=1) for _ in range(2))

    def forward(self, image: Tensor) -> Tensor:
        return image + self.conv2(relu(self.conv1(relu(image))))


class _Fusion(nn.Module):
    """Adds a finer scale to what came from the coarser ones and doubles the size."""

    def __init__(self, dim: int):
        super().__init__()
        self.resConfUnit1, self.resConfUnit2 = _Residual(dim), _Residual(dim)
        self.out_conv = nn.Conv2d(dim, dim, 1)

    def forward(self, coarse: Tensor, fine: Tensor | None = None) -> Tensor:
        image = coarse if fine is None else coarse + self.resConfUnit1(fine)
        return self.out_conv(_doubled(self.resConfUnit2(image)))


class _Scales(nn.Module):
    """Brings the four scales to one width; fuses them from coarse to fine."""

    def __init__(self, sizes: DptSizes):
        super().__init__()
        for number, width in enumerate(sizes.scales, start=1):
            self.add_module(f"layer{number}_rn", nn.Conv2d(width, sizes.fused, 3, padding=1, bias=False))
            self.add_module(f"refinenet{number}", _Fusion(sizes.fused))

    def forward(self, scales: Sequence[Tensor]) -> Tensor:
        even = [self.get_submodule(f"layer{n}_rn")(scale) for n, scale in enumerate(scales, start=1)]
        rows, columns = even[2].shape[-2:]  # an odd number of patches was rounded up on the way to the coarsest scale
        path = self.get_submodule("refinenet4")(even[3])[..., :rows, :columns]
        for number in (3, 2, 1):
            path = self.get_submodule(f"refinenet{number}")(path, even[number - 1])
        return path


class _Dpt(nn.Module):
    """The head itself, under the name that the checkpoints give it."""

    def __init__(self, dims: Sequence[int], sizes: DptSizes):
        super().__init__()
        a, b, _, d = sizes.scales
        first = [nn.Conv2d(dim, width, 1) for dim, width in zip(dims, sizes.scales, strict=True)]
        resized = (
            nn.Sequential(first[0], nn.ConvTranspose2d(a, a, 4, stride=4)),
            nn.Sequential(first[1], nn.ConvTranspose2d(b, b, 2, stride=2)),
            nn.Sequential(first[2]),
            nn.Sequential(first[3], nn.Conv2d(d, d, 3, stride=2, padding=1)),
        )
        self.act_postprocess = nn.ModuleList(resized)
        self.scratch = _Scales(sizes)
        half = sizes.fused // 2
        self.head = nn.Sequential(
            nn.Conv2d(sizes.fused, half, 3, padding=1),
            _doubled,
            nn.Conv2d(half, sizes.last, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(sizes.last, OUTPUTS, 1),
        )

    def forward(self, patches: Sequence[Tensor]) -> Tensor:
        scales = [resize(image) for resize, image in zip(self.act_postprocess, patches, strict=True)]
        return self.head(self.scratch(scales))


class DptHead(nn.Module):
    """Four layers of tokens at four scales, fused from coarse to fine; 16 x 16 pixels a patch.

    `dims` are the channels of the four layers at `hooks`. Source: Ranftl et al., "Vision transformers for dense
    prediction", ICCV 2021.
    """

    def __init__(self, dims: Sequence[int], hooks: Sequence[int], sizes: DptSizes):
        super().__init__()
        self.hooks = tuple(hooks)
        self.dpt = _Dpt(dims, sizes)

    def forward(self, layers: Sequence[Tensor], grid: tuple[int, int]) -> Tensor:
        """Map layers of tokens [b, n, c] to [b, 4, H, W]."""
        return self.dpt([spread(layers[hook], grid) for hook in self.hooks])
