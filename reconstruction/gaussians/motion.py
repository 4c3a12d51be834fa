"""What every motion model promises, and the plainest one: a low polynomial of time, seen for a while.

Letters: M moving Gaussians. Time is in clips: 0 at the clip's start, 1 at its end, so that one learning rate fits clips
of any length. With s = u - `instants` a Gaussian is at `means + velocities s + accelerations s^2 / 2 + jerks s^3 / 6`
and its opacity is gated by exp(-(s / durations)^2 / 2). Sources: Yang et al., "FreeTimeGS", CVPR 2025 (straight, own
time window); Li et al., "Spacetime Gaussian feature splatting", CVPR 2024 (cubic).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.course import Course, evaluated


class Instantaneous(NamedTuple):
    """What the renderer takes: opacities are in [0, 1], after the gate; the rest is encoded as in the cloud."""

    means: Tensor  # [N + M, 3]
    quats_wxyz: Tensor  # [N + M, 4]
    log_scales: Tensor  # [N + M, 3]
    opacities: Tensor  # [N + M]
    intensities: Tensor  # [N + M, C]


class MotionModel(ABC):
    """How M Gaussians move. What a model stores are its tensors, named as `tensors` yields them."""

    kind: ClassVar[str]  # as a checkpoint names it
    fixed: ClassVar[frozenset[str]] = frozenset()  # tensors that no training changes

    @abstractmethod
    def at(self, moving: GaussianCloud, u: float) -> Instantaneous:
        """The M Gaussians at u, in clips; differentiable in everything stored, finite for any finite u."""

    def tensors(self) -> Iterator[tuple[str, Tensor]]:
        """Every stored tensor by a stable name."""
        yield from vars(self).items()

    def span(self) -> tuple[float, float]:
        """The part of the clip, in clips, that training looks at now."""
        return 0.0, 1.0

    def advance(self, moving: GaussianCloud, done: float) -> float:
        """Told before every step how much of the training lies behind; returns how much of its own stage does."""
        return done

    def penalty(self, moving: GaussianCloud) -> Tensor | None:
        """What the model's own regulariser adds to the loss, where it has one."""
        return None


@dataclass
class Motion(MotionModel):
    """Each on a path of its own; straight where accelerations and jerks are empty [0, 3]."""

    kind = "polynomial"
    velocities: Tensor  # [M, 3] m per clip
    accelerations: Tensor  # [M, 3] m per clip^2, or [0, 3]
    jerks: Tensor  # [M, 3] m per clip^3, or [0, 3]
    instants: Tensor  # [M] clips
    log_durations: Tensor  # [M] log clips

    @classmethod
    def at_rest(cls, instants: Tensor, duration: float, *, cubic: bool = False) -> Motion:
        """No velocity yet; each alive around its instant for about `duration` clips."""
        logs = torch.full_like(instants, math.log(duration))
        still = torch.zeros(len(instants), 3, dtype=instants.dtype)
        bends = still if cubic else still[:0]
        return cls(still, bends.clone(), bends.clone(), instants.clone(), logs)

    def at(self, moving: GaussianCloud, u: float) -> Instantaneous:
        """Moved along, turned and stretched as stored, as opaque as the window lets them."""
        bends = (self.accelerations / 2, self.jerks / 6) if len(self.accelerations) else ()
        coefficients = (self.velocities, *bends)
        course = Course(moving.means, moving.opacity_logits, self.instants, self.log_durations, coefficients)
        means, opacities = evaluated(moving.means[:0], moving.opacity_logits[:0], course, u)
        return Instantaneous(means, moving.quats_wxyz, moving.log_scales, opacities, moving.intensities)
