"""Holds what is rendered to depths that were confirmed before the training: fewer layers that shine through.

Letters: H rows, W columns, K pixels with a confirmed depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.rendering.result import Rendering


@dataclass(frozen=True, eq=False)
class ConfirmedDepth:
    """The pixels of a view whose depth is known: indices [K] row by row, and depths [K] there in m."""

    pixels: Tensor
    depth: Tensor

    @classmethod
    def of(cls, depth: NDArray[np.float32]) -> ConfirmedDepth:
        """Make it from a map [H, W] in m that is NaN where nothing is known."""
        flat = torch.from_numpy(np.ascontiguousarray(depth).ravel())
        pixels = torch.nonzero(flat.isfinite() & (flat > 0)).squeeze(1)
        return cls(pixels, flat[pixels])

    def without(self, mask: NDArray[np.bool_]) -> ConfirmedDepth:
        """Return the same without the pixels of a mask [H, W]."""
        kept = ~torch.from_numpy(np.ascontiguousarray(mask).ravel())[self.pixels]
        return ConfirmedDepth(self.pixels[kept], self.depth[kept])


@dataclass(frozen=True)
class DepthHold:
    """A loss on the light's mean distance from a confirmed depth, as a share of that depth.

    The sum of weight times (z - depth) / depth over what covers a pixel, as an absolute value; beyond `most` it pulls
    no more, for there the depth is wrong. In a mean over all H W pixels.
    """

    weight: float
    most: float = 0.05

    def __call__(self, rendered: Rendering, known: ConfirmedDepth) -> Tensor:
        """Return the loss of one render of the view whose depths are known."""
        depth, alpha = (image.flatten()[known.pixels] for image in (rendered.depth, rendered.alpha))
        off = (depth / known.depth.to(depth.dtype) - alpha).abs()
        return self.weight * off.clamp_max(self.most).sum() / rendered.alpha.numel()
