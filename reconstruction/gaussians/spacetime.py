"""Spacetime Gaussians: each on a cubic path of its own, turning at an even rate, seen around an instant of its own.

Letters as in `polynomial`. With s = u - `instants` a Gaussian's quaternion is `quats_wxyz + turns s`, and the renderer
makes it unit; its place and opacity are those of the cubic `PolynomialMotion`. Source: Li et al., "Spacetime Gaussian
feature splatting", CVPR 2024, equations 6 to 9 (cubic place, linear quaternion, Gaussian window).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.rendering.result import Instantaneous
from reconstruction.scene_model import Rate


@dataclass
class SpacetimeMotion(PolynomialMotion):
    """The cubic `PolynomialMotion` whose Gaussians also turn."""

    kind = "stg"
    rates: ClassVar[Mapping[str, Rate]] = {**PolynomialMotion.rates, "turns": Rate(3e-2)}
    turns: Tensor  # [M, 4] change of the stored quaternion per clip

    @classmethod
    def started(cls, instants: Tensor, duration: float) -> SpacetimeMotion:
        """Return a motion without velocities or turns, each Gaussian alive around its instant for `duration` clips."""
        motion = PolynomialMotion.at_rest(instants, duration, cubic=True)
        return cls(**vars(motion), turns=torch.zeros(len(instants), 4, dtype=instants.dtype))

    def at(self, moving: GaussianCloud, u: float) -> Instantaneous:
        """Return the Gaussians moved along their paths and turned, as opaque as their windows let them be."""
        quats = moving.quats_wxyz + self.turns * (u - self.instants)[:, None]
        return super().at(moving, u)._replace(quats_wxyz=quats)
