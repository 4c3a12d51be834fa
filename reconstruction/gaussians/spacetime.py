"""Spacetime Gaussians: each on a cubic path of its own, turning at an even rate, seen around an instant of its own.

Letters as in `motion`: with s = u - `instants` a Gaussian's quaternion is `quats_wxyz + turns s`, made unit by the
renderer; place and opacity are those of the cubic `Motion`. Source: Li et al., "Spacetime Gaussian feature splatting",
CVPR 2024, equations 6 to 9 (cubic place, linear quaternion, Gaussian window).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.motion import Instantaneous, Motion


@dataclass
class SpacetimeMotion(Motion):
    """The cubic `Motion` whose Gaussians also turn."""

    kind = "stg"
    turns: Tensor  # [M, 4] change of the stored quaternion per clip

    @classmethod
    def started(cls, instants: Tensor, duration: float) -> SpacetimeMotion:
        """Neither moving nor turning yet; each alive around its instant for about `duration` clips."""
        motion = Motion.at_rest(instants, duration, cubic=True)
        return cls(**vars(motion), turns=torch.zeros(len(instants), 4, dtype=instants.dtype))

    def at(self, moving: GaussianCloud, u: float) -> Instantaneous:
        """Moved along and turned, stretched as stored, as opaque as the window lets them."""
        quats = moving.quats_wxyz + self.turns * (u - self.instants)[:, None]
        return super().at(moving, u)._replace(quats_wxyz=quats)
