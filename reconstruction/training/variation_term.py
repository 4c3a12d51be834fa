"""Compares how renders and images change over a few instants. Letters: H rows, W columns, Q instants."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.losses.variation import variation_loss
from reconstruction.training.image_term import ImageTerm, target_planes
from reconstruction.training.view import TrainingView


@dataclass(frozen=True)
class ImageVariationTerm:
    """Compares renders with target images at `instants` instants `gap` planes apart, and their changes in between.

    `weight` is that of the variation loss beside the image term.
    """

    image: ImageTerm
    weight: float = 0.5
    instants: int = 3
    gap: int = 24

    def __call__(self, cloud: DynamicCloud, view: TrainingView, rng: np.random.Generator) -> Tensor:
        """Return the loss of instants that begin at a random plane."""
        instants = target_planes(cloud, view, self.image.stride)
        gap = max(1, min(self.gap // self.image.stride, (len(instants) - 1) // (self.instants - 1)))
        first = int(rng.integers(max(1, len(instants) - gap * (self.instants - 1))))
        at = [int(instants[min(first + i * gap, len(instants) - 1)]) for i in range(self.instants)]
        pairs = [self.image.pair(cloud, view, plane) for plane in at]
        pixels = torch.stack([self.image.held(view, r, t) for r, t in pairs]).mean()
        rendered = torch.stack([r.intensity[..., 0] for r, _ in pairs])
        target = torch.stack([t for _, t in pairs])
        return pixels + self.weight * variation_loss(rendered, target) / self.image.white
