"""Transformer blocks that attend within one image and between two, with positions in the plane.

Letters: b images, n tokens (patches, row by row), c channels, h heads, d channels a head.
Parameter names are those of the public CroCo v2 and DUSt3R checkpoints; that is why some are short.
Sources: Dosovitskiy et al., "An image is worth 16x16 words", ICLR 2021; Su et al., "RoFormer", 2021, in two dimensions
as in Weinzaepfel et al., "CroCo v2", ICCV 2023.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention

NORM_EPS = 1e-6


class Turns(NamedTuple):
    """Cosines and sines [n, d] by which the channels of a head are turned at each token."""

    cos: Tensor
    sin: Tensor

    @classmethod
    def of_grid(cls, grid: tuple[int, int], head_dim: int, base: float, like: Tensor) -> Turns:
        """Return the turns of rows x columns patches: a head's first half follows the row, its second half the column.

        Frequencies fall from 1 to 1 / `base` radians a patch. `head_dim` is a multiple of 4.
        """
        quarter = head_dim // 4
        frequencies = base ** (-torch.arange(quarter, dtype=torch.float32, device=like.device) / quarter)
        rows, columns = (torch.arange(n, dtype=torch.float32, device=like.device) for n in grid)
        y, x = (axis.reshape(-1, 1) * frequencies for axis in torch.meshgrid(rows, columns, indexing="ij"))
        angles = torch.cat([y, y, x, x], dim=-1).to(like.dtype)  # [n, d]
        return cls(angles.cos(), angles.sin())

    def apply(self, tokens: Tensor) -> Tensor:
        """Turn [b, h, n, d]: in each half of the channels, channel k with channel k + d / 4."""
        a, b, c, d = tokens.chunk(4, dim=-1)
        return tokens * self.cos + torch.cat([-b, a, -d, c], dim=-1) * self.sin


def _split(tokens: Tensor, heads: int) -> Tensor:
    """Split tokens [b, n, c] into heads [b, h, n, d]."""
    return tokens.unflatten(-1, (heads, -1)).transpose(1, 2)


def _attend(query: Tensor, key: Tensor, value: Tensor) -> Tensor:
    """Attend by heads [b, h, n, d] and join them to [b, n, c]."""
    return scaled_dot_product_attention(query, key, value).transpose(1, 2).flatten(2)


class Attention(nn.Module):
    """Tokens of one image attend to one another."""

    def __init__(self, dim: int, heads: int):
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(dim, 3 * dim)
        self.proj = nn.Linear(dim, dim)

    def forward(self, tokens: Tensor, turns: Turns) -> Tensor:
        """Map [b, n, c] to [b, n, c]."""
        query, key, value = (_split(part, self.heads) for part in self.qkv(tokens).chunk(3, dim=-1))
        return self.proj(_attend(turns.apply(query), turns.apply(key), value))


class CrossAttention(nn.Module):
    """Tokens of one image attend to those of another."""

    def __init__(self, dim: int, heads: int):
        super().__init__()
        self.heads = heads
        self.projq, self.projk, self.projv, self.proj = (nn.Linear(dim, dim) for _ in range(4))

    def forward(self, tokens: Tensor, other: Tensor, turns: Turns, other_turns: Turns) -> Tensor:
        """Map [b, n, c] and the other image's [b, m, c] to [b, n, c]."""
        query = turns.apply(_split(self.projq(tokens), self.heads))
        key = other_turns.apply(_split(self.projk(other), self.heads))
        return self.proj(_attend(query, key, _split(self.projv(other), self.heads)))


def _mlp(dim: int) -> nn.Sequential:
    """Return two linear maps with a GELU between them, the inner one four times as wide."""
    return nn.Sequential(OrderedDict(fc1=nn.Linear(dim, 4 * dim), act=nn.GELU(), fc2=nn.Linear(4 * dim, dim)))


class EncoderBlock(nn.Module):
    """Attention, then an MLP, each added to what comes in."""

    def __init__(self, dim: int, heads: int):
        super().__init__()
        self.norm1 = nn.LayerNorm(dim, eps=NORM_EPS)
        self.attn = Attention(dim, heads)
        self.norm2 = nn.LayerNorm(dim, eps=NORM_EPS)
        self.mlp = _mlp(dim)

    def forward(self, tokens: Tensor, turns: Turns) -> Tensor:
        """Map [b, n, c] to [b, n, c]."""
        tokens = tokens + self.attn(self.norm1(tokens), turns)
        return tokens + self.mlp(self.norm2(tokens))


class DecoderBlock(nn.Module):
    """Attention within the image, then to the other image, then an MLP, each added to what comes in."""

    def __init__(self, dim: int, heads: int):
        super().__init__()
        self.norm1 = nn.LayerNorm(dim, eps=NORM_EPS)
        self.attn = Attention(dim, heads)
        self.cross_attn = CrossAttention(dim, heads)
        self.norm2 = nn.LayerNorm(dim, eps=NORM_EPS)
        self.norm3 = nn.LayerNorm(dim, eps=NORM_EPS)
        self.mlp = _mlp(dim)
        self.norm_y = nn.LayerNorm(dim, eps=NORM_EPS)

    def forward(self, tokens: Tensor, other: Tensor, turns: Turns, other_turns: Turns) -> Tensor:
        """Map [b, n, c] and the other image's [b, m, c] to [b, n, c]."""
        tokens = tokens + self.attn(self.norm1(tokens), turns)
        tokens = tokens + self.cross_attn(self.norm2(tokens), self.norm_y(other), turns, other_turns)
        return tokens + self.mlp(self.norm3(tokens))


class PatchEmbedding(nn.Module):
    """Each square patch of pixels becomes one token."""

    def __init__(self, channels: int, dim: int, patch_px: int):
        super().__init__()
        self.proj = nn.Conv2d(channels, dim, kernel_size=patch_px, stride=patch_px)

    def forward(self, images: Tensor) -> Tensor:
        """Map [b, channels, H, W] to [b, n, c], row by row."""
        return self.proj(images).flatten(2).transpose(1, 2)
