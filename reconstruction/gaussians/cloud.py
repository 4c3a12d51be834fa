"""Gaussians as they are stored: tensors whose names carry their encodings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from reconstruction.errors import ReconstructionError
from reconstruction.scene_model import Rate


@dataclass
class GaussianCloud:
    """N Gaussians, of which every tensor is named by what it holds and how that is encoded.

    Raises ReconstructionError for shapes that do not fit one another or numbers that are not finite.
    """

    rates: ClassVar[Mapping[str, Rate]] = {
        "means": Rate(1e-3, "scene"),
        "quats_wxyz": Rate(1e-2),
        "log_scales": Rate(8e-2),
        "opacity_logits": Rate(6e-2),
        "intensities": Rate(8e-3, "light"),
    }
    means: Tensor  # [N, 3] m, rig frame
    quats_wxyz: Tensor  # [N, 4] of any length
    log_scales: Tensor  # [N, 3] log m
    opacity_logits: Tensor  # [N]
    intensities: Tensor  # [N, C] linear, spikes per tick

    def __post_init__(self) -> None:
        n = len(self.means)
        shapes = {"means": (n, 3), "quats_wxyz": (n, 4), "log_scales": (n, 3), "opacity_logits": (n,)}
        for name, tensor in vars(self).items():
            shape = shapes.get(name, (n, *self.intensities.shape[1:2]))
            if tensor.shape != shape or tensor.ndim != len(shape):
                raise ReconstructionError(f"found {name} of shape {tuple(tensor.shape)}", str(shape))
            if not torch.isfinite(tensor.detach()).all():
                raise ReconstructionError(f"found NaN or infinity in {name}", "finite numbers")
        if self.intensities.ndim != 2:
            raise ReconstructionError(f"found intensities of shape {tuple(self.intensities.shape)}", f"({n}, C)")

    @classmethod
    def from_points(cls, points: Tensor, intensities: Tensor, log_scales: Tensor, opacity: float) -> GaussianCloud:
        """Return round Gaussians at points [N, 3] in m with intensities [N, C] and log standard deviations [N]."""
        quats = torch.zeros(len(points), 4)
        quats[:, 0] = 1
        logits = torch.full_like(log_scales, math.log(opacity / (1 - opacity)))
        return cls(points.clone(), quats, log_scales[:, None].repeat(1, 3), logits, intensities.clone())

    def __len__(self) -> int:
        return len(self.means)

    def select(self, which: Tensor) -> GaussianCloud:
        """Return the Gaussians at indices, or where a mask [N] is true."""
        return GaussianCloud(*(t[which] for t in vars(self).values()))
