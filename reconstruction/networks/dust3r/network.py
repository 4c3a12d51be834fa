"""The DUSt3R network: two images to two maps of points in the first camera's frame, and how sure it is of them.

Letters: b pairs, n patches of an image, c channels, H x W pixels. Written from the paper and the layout of the public
checkpoints, so that those can be loaded. Source: Wang et al., "DUSt3R: geometric 3D vision made easy", CVPR 2024.
"""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from reconstruction.errors import BadRunError
from reconstruction.networks.dust3r.blocks import NORM_EPS, DecoderBlock, EncoderBlock, PatchEmbedding, Turns
from reconstruction.networks.dust3r.heads import DptHead, DptSizes, LinearHead

MOST_LOG = 20.0  # of a distance or confidence: exp(20) = 5e8 is beyond any scene, far below where float32 overflows
DPT_PATCH_PX = 16
LARGEST = 65536  # channels, blocks, heads or pixels: beyond any transformer


class PointMap(NamedTuple):
    """`points` [b, H, W, 3] in the first camera's frame, up to scale; `confidence` [b, H, W] >= 1, larger is better."""

    points: Tensor
    confidence: Tensor


@dataclass(frozen=True)
class Architecture:
    """Sizes of the network; the defaults are those of the published ViT-Large encoder with a Base decoder.

    Raises BadRunError for sizes that do not fit one another.
    """

    encoder_dim: int = 1024
    encoder_depth: int = 24
    encoder_heads: int = 16
    decoder_dim: int = 768
    decoder_depth: int = 12
    decoder_heads: int = 12
    patch_px: int = 16
    rope_base: float = 100.0
    head: Literal["linear", "dpt"] = "dpt"
    dpt: DptSizes = field(default_factory=DptSizes)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            sized = name.endswith(("_dim", "_depth", "_heads", "_px"))
            if sized and (type(value) is not int or not 1 <= value <= LARGEST):
                raise BadRunError(f"found {name}={str(value)[:20]}", f"a whole number from 1 to {LARGEST}")
        for dim, heads in ((self.encoder_dim, self.encoder_heads), (self.decoder_dim, self.decoder_heads)):
            if dim % (4 * heads):
                raise BadRunError(f"found {dim} channels for {heads} heads", f"a multiple of {4 * heads}")
        if not self.rope_base > 1:
            raise BadRunError(f"found the rotary base {self.rope_base}", "more than 1")
        if self.head == "dpt" and (self.decoder_depth < 4 or self.patch_px != DPT_PATCH_PX):
            found = f"{self.decoder_depth} decoder blocks and patches of {self.patch_px} pixels"
            raise BadRunError(f"found {found}", f"at least 4 and {DPT_PATCH_PX} for a DPT head")


class Backbone(nn.Module):
    """The encoder and the first decoder of one `Architecture`."""

    def __init__(self, architecture: Architecture):
        super().__init__()
        a = self.architecture = architecture
        self.patch_embed = PatchEmbedding(3, a.encoder_dim, a.patch_px)
        self.enc_blocks = nn.ModuleList(EncoderBlock(a.encoder_dim, a.encoder_heads) for _ in range(a.encoder_depth))
        self.enc_norm = nn.LayerNorm(a.encoder_dim, eps=NORM_EPS)
        self.decoder_embed = nn.Linear(a.encoder_dim, a.decoder_dim)
        self.dec_blocks = _decoder_blocks(a)
        self.dec_norm = nn.LayerNorm(a.decoder_dim, eps=NORM_EPS)

    def grid(self, images: Tensor) -> tuple[int, int]:
        """Return the rows and columns of patches of images [..., H, W]; BadRunError where they do not come out even."""
        height, width = images.shape[-2:]
        patch = self.architecture.patch_px
        if height % patch or width % patch:
            raise BadRunError(f"found images of {width}x{height}", f"multiples of {patch}", "pad them")
        return height // patch, width // patch

    def encode(self, images: Tensor) -> Tensor:
        """Encode images [b, 3, H, W] in [-1, 1] to tokens [b, n, encoder_dim]."""
        a = self.architecture
        turns = Turns.of_grid(self.grid(images), a.encoder_dim // a.encoder_heads, a.rope_base, images)
        tokens = self.patch_embed(images)
        for block in self.enc_blocks:
            tokens = block(tokens, turns)
        return self.enc_norm(tokens)


class Dust3r(Backbone):
    """The network of one `Architecture`; `encode` each image once, then decode each pair with `forward`."""

    def __init__(self, architecture: Architecture):
        super().__init__(architecture)
        self.mask_token = nn.Parameter(torch.zeros(1, 1, architecture.decoder_dim))  # unused, but in every checkpoint
        self.dec_blocks2 = _decoder_blocks(architecture)
        self.downstream_head1, self.downstream_head2 = _head(architecture), _head(architecture)

    def decode(self, first: Tensor, second: Tensor, turns: Turns) -> tuple[list[Tensor], list[Tensor]]:
        """Decode encoded pairs to each side's layers: the encoder's tokens, then those after every block [b, n, c]."""
        one, two = self.decoder_embed(first), self.decoder_embed(second)
        ones, twos = [first], [second]
        for block, block2 in zip(self.dec_blocks, self.dec_blocks2, strict=True):
            one, two = block(one, two, turns, turns), block2(two, one, turns, turns)
            ones.append(one)
            twos.append(two)
        ones[-1], twos[-1] = self.dec_norm(one), self.dec_norm(two)
        return ones, twos

    def forward(self, first: Tensor, second: Tensor, grid: tuple[int, int]) -> tuple[PointMap, PointMap]:
        """Map encoded pairs [b, n, encoder_dim] to the points of either image, both in the first camera's frame."""
        a = self.architecture
        turns = Turns.of_grid(grid, a.decoder_dim // a.decoder_heads, a.rope_base, first)
        ones, twos = self.decode(first, second, turns)
        return unfolded(self.downstream_head1(ones, grid)), unfolded(self.downstream_head2(twos, grid))


def _decoder_blocks(a: Architecture) -> nn.ModuleList:
    return nn.ModuleList(DecoderBlock(a.decoder_dim, a.decoder_heads) for _ in range(a.decoder_depth))


def _head(a: Architecture) -> LinearHead | DptHead:
    if a.head == "linear":
        return LinearHead(a.decoder_dim, a.patch_px)
    hooks = (0, a.decoder_depth // 2, a.decoder_depth * 3 // 4, a.decoder_depth)  # layer 0 is the encoder's
    return DptHead((a.encoder_dim, *[a.decoder_dim] * 3), hooks, a.dpt)


def unfolded(outputs: Tensor) -> PointMap:
    """Turn channels [b, 4, H, W] into points = direction * expm1(norm) and confidence = 1 + exp (DUSt3R, eq. 4).

    Both exponents are clamped, so that an odd image cannot overflow.
    """
    vectors, logits = outputs[:, :3].permute(0, 2, 3, 1), outputs[:, 3]
    norms = vectors.norm(dim=-1, keepdim=True)
    distances = torch.expm1(norms.clamp(max=MOST_LOG))
    points = vectors / norms.clamp(min=1e-8) * distances
    return PointMap(points, 1 + torch.exp(logits.clamp(max=MOST_LOG)))
