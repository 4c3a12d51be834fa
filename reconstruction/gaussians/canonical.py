"""Motion models that deform one canonical cloud by a field: the box it covers, and its effect on a Gaussian."""

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor
from torch.nn.functional import linear

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.motion_model import MotionModel
from reconstruction.rendering.result import Instantaneous

STRAY = 0.02  # share of points at each end of an axis that the box leaves out
OUTPUTS = (3, 4, 3)  # position, quaternion, log scales


@dataclass
class CanonicalMotion(MotionModel):
    """Offsets of position, quaternion and log scales in a `box`, of which it holds the lowest and highest corner.

    Offsets of positions are in units of half the box, so that one learning rate fits scenes of any size. Beyond the box
    and the clip the field continues as at its edge.
    """

    box: Tensor  # [2, 3] m

    @classmethod
    @abstractmethod
    def around(cls, means: Tensor, least_m: float, generator: torch.Generator) -> Self:
        """Return a field that deforms nothing yet, over the box that `box_around` finds for `means` [M, 3] in m."""

    def at(self, moving: GaussianCloud, u: float) -> Instantaneous:
        """Return every Gaussian shifted, turned and stretched by the field at its canonical mean and u."""
        low, high = self.box
        half = (high - low) / 2
        places = ((moving.means - low) / half - 1).clamp(-1, 1)
        shift, turn, stretch = self.offsets(places, min(max(u, 0.0), 1.0))
        return Instantaneous(
            moving.means + shift * half,
            moving.quats_wxyz + turn,
            moving.log_scales + stretch,
            moving.opacity_logits.sigmoid(),
            moving.intensities,
        )

    @abstractmethod
    def offsets(self, places: Tensor, u: float) -> tuple[Tensor, Tensor, Tensor]:
        """Return offsets [M, 3], [M, 4], [M, 3] at `places` [M, 3] in -1 to 1 and u in 0 to 1."""


def box_around(means: Tensor, least_m: float) -> Tensor:
    """Return the corners [2, 3] of a cube over most of `means` [M, 3] with half as much again on every side, in m.

    Half the cube is at least `least_m`: points close to one another do not tell how far they may go.
    """
    low, high = means.quantile(STRAY, dim=0), means.quantile(1 - STRAY, dim=0)
    half = ((high - low) / 2).amax().clamp_min(least_m) * 1.5
    return torch.stack([(low + high) / 2 - half, (low + high) / 2 + half])


def layer(shape: tuple[int, int], generator: torch.Generator) -> Tensor:
    """Return Xavier's uniform weights [m, n + 1] for `shape` (m, n), with a last column of zeros for the bias."""
    reach = math.sqrt(6 / sum(shape))
    weights = torch.empty(shape).uniform_(-reach, reach, generator=generator)
    return torch.cat([weights, torch.zeros(shape[0], 1)], dim=1)


def affine(weights: Tensor, values: Tensor) -> Tensor:
    """Return `values` [M, n] after a layer `weights` [m, n + 1] whose last column is the bias, [M, m]."""
    return linear(values, weights[:, :-1], weights[:, -1])
