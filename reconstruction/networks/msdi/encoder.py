"""The encoder of MSDI's small tier: a convolutional stem and a vision transformer that looks across the views.

Per view: cells of 2, 4 and 8 px; the last are the tokens. Blocks alternate between attention inside a view, with
rotary positions (Su et al., "RoFormer", 2021; in two axes as in CroCo v2, Weinzaepfel et al., ICCV 2023), and attention
to those tokens of the other views that the nominal rig allows. The way back up gives fine features (as LoFTR's: Sun et
al., "LoFTR", CVPR 2021). Letters: V views, N tokens a view, D the tokens' dimensions.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from reconstruction.networks.dust3r.blocks import Turns
from reconstruction.networks.msdi.features import CHANNELS, PATCH
from reconstruction.networks.spk2imgnet_small import ResidualBlock, doubled

FINE_WIDTH, MIDDLE_WIDTH, TOKEN_WIDTH = 24, 48, 96
HEADS, BLOCKS = 4, 4  # blocks: self, cross, self, cross
FREQUENCY = 100.0  # RoPE's base


class Encoded(NamedTuple):
    """Features of V views: `tokens` [V, N, D], `middle` [V, M, H / 4, W / 4] and `fine` [V, F, H / 2, W / 2]."""

    tokens: Tensor
    middle: Tensor
    fine: Tensor


class Trunk(nn.Module):
    """Blocks over the tokens of all views, first inside each view, then across, in turn; views in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(Block(TOKEN_WIDTH, across=bool(b % 2)) for b in range(BLOCKS))
        self.norm = nn.LayerNorm(TOKEN_WIDTH)

    def forward(self, tokens: Tensor, seen: Tensor, gate: Tensor) -> Tensor:
        """Map tokens [V, N, D] of the patches of `seen` [V, CHANNELS, H, W], and the gate [V, N, V, N], to tokens."""
        grid = (seen.shape[2] // PATCH, seen.shape[3] // PATCH)
        turns = Turns.of_grid(grid, TOKEN_WIDTH // HEADS, FREQUENCY, tokens)
        for block in self.blocks:
            tokens = block(tokens, turns, gate)
        return self.norm(tokens)


class Encoder(nn.Module):
    """Channels [V, CHANNELS, H, W] and the gate [V, N, V, N] to features; views in another order give the same.

    The `trunk` makes new tokens from tokens and features: see `Trunk`, and `large` for another one.
    """

    def __init__(self, trunk: nn.Module) -> None:
        super().__init__()
        self.stem = nn.Sequential(nn.Conv2d(CHANNELS, FINE_WIDTH, 5, 2, 2), nn.ReLU(), ResidualBlock(FINE_WIDTH))
        self.down4 = nn.Sequential(nn.Conv2d(FINE_WIDTH, MIDDLE_WIDTH, 2, 2), ResidualBlock(MIDDLE_WIDTH))
        self.down8 = nn.Conv2d(MIDDLE_WIDTH, TOKEN_WIDTH, 2, 2)
        self.trunk = trunk
        self.up4 = nn.Conv2d(TOKEN_WIDTH, MIDDLE_WIDTH, 1)
        self.merge4 = ResidualBlock(MIDDLE_WIDTH)
        self.up2 = nn.Conv2d(MIDDLE_WIDTH, FINE_WIDTH, 1)
        self.merge2 = ResidualBlock(FINE_WIDTH)

    def forward(self, seen: Tensor, gate: Tensor) -> Encoded:
        """Return the features of channels `seen` [V, CHANNELS, H, W]; see the class."""
        at2 = self.stem(seen)
        at4 = self.down4(at2)
        at8 = self.down8(functional.relu(at4))
        tokens = self.trunk(at8.flatten(2).transpose(1, 2), seen, gate)
        grid = tokens.transpose(1, 2).unflatten(2, at8.shape[2:])
        middle = self.merge4(at4 + doubled(self.up4(grid)))
        fine = self.merge2(at2 + doubled(self.up2(functional.relu(middle))))
        return Encoded(tokens, middle, fine)


class Block(nn.Module):
    """Attention inside each view, or `across` to the other views' tokens, then two linear layers."""

    def __init__(self, width: int, across: bool) -> None:
        super().__init__()
        self.across = across
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv, self.proj = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, 3 * width), nn.GELU(), nn.Linear(3 * width, width))

    def forward(self, tokens: Tensor, turns: Turns, gate: Tensor) -> Tensor:
        """Map tokens [V, N, D], with RoPE's `turns` and the gate [V, N, V, N], to tokens."""
        views, number, width = tokens.shape
        parts = self.qkv(self.norm1(tokens)).unflatten(2, (3, HEADS, -1)).permute(2, 0, 3, 1, 4)
        if self.across:
            query, key, value = parts.transpose(1, 2).flatten(2, 3)[:, None]  # [1, HEADS, V N, D / HEADS] each
            allowed = gate.reshape(views * number, views * number)
            alone = ~allowed.any(dim=1, keepdim=True) & torch.eye(views * number, dtype=torch.bool)
            found = functional.scaled_dot_product_attention(query, key, value, attn_mask=allowed | alone)
            found = found[0].transpose(0, 1).reshape(views, number, width)
        else:
            query, key, value = parts
            query, key = turns.apply(query), turns.apply(key)
            found = functional.scaled_dot_product_attention(query, key, value).transpose(1, 2).flatten(2)
        tokens = tokens + self.proj(found)
        return tokens + self.mlp(self.norm2(tokens))
