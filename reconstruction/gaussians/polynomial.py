"""Each Gaussian on a path of its own, a polynomial of time, and visible for a while.

Letters: M moving Gaussians. With s = u - `instants` in clips, a Gaussian is at
`means + velocities s + accelerations s^2 / 2 + jerks s^3 / 6` and its opacity is gated by exp(-(s / durations)^2 / 2).
Sources: Yang et al., "FreeTimeGS", CVPR 2025 (straight, a time window of its own); Li et al., "Spacetime Gaussian
feature splatting", CVPR 2024 (cubic).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.course import Course, evaluated
from reconstruction.gaussians.motion_model import MotionModel
from reconstruction.rendering.result import Instantaneous
from reconstruction.scene_model import Rate

WINDOW_RATES = {"instants": Rate(4e-3), "log_durations": Rate(2e-2)}


@dataclass
class PolynomialMotion(MotionModel):
    """Cubic paths; straight ones where accelerations and jerks are empty [0, 3]."""

    kind = "polynomial"
    rates: ClassVar[Mapping[str, Rate]] = {
        "velocities": Rate(3e-3, "scene"),
        "accelerations": Rate(5e-2, "scene"),
        "jerks": Rate(1.2, "scene"),
        **WINDOW_RATES,
    }
    velocities: Tensor  # [M, 3] m per clip
    accelerations: Tensor  # [M, 3] m per clip^2, or [0, 3]
    jerks: Tensor  # [M, 3] m per clip^3, or [0, 3]
    instants: Tensor  # [M] clips
    log_durations: Tensor  # [M] log clips

    @classmethod
    def at_rest(cls, instants: Tensor, duration: float, *, cubic: bool = False) -> PolynomialMotion:
        """Return a motion without velocities, each Gaussian alive around its instant [M] for about `duration` clips."""
        logs = torch.full_like(instants, math.log(duration))
        still = torch.zeros(len(instants), 3, dtype=instants.dtype)
        bends = still if cubic else still[:0]
        return cls(still, bends.clone(), bends.clone(), instants.clone(), logs)

    def at(self, moving: GaussianCloud, u: float) -> Instantaneous:
        """Return the Gaussians moved along their paths, as opaque as their windows let them be."""
        bends = (self.accelerations / 2, self.jerks / 6) if len(self.accelerations) else ()
        coefficients = (self.velocities, *bends)
        course = Course(moving.means, moving.opacity_logits, self.instants, self.log_durations, coefficients)
        means, opacities = evaluated(course, u)
        return Instantaneous(means, moving.quats_wxyz, moving.log_scales, opacities, moving.intensities)
