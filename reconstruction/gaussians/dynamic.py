"""Still Gaussians beside Gaussians that move in a straight line and live for a while.

Letters: N still, M moving. Time is in clips: 0 at the clip's start, 1 at its end, so that one learning rate fits
clips of any length. A moving Gaussian is at `means + velocities * (u - instants)` and its opacity is gated by
exp(-((u - instants) / durations)^2 / 2). Source: Yang et al., "FreeTimeGS", CVPR 2025.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from reconstruction.errors import ReconstructionError
from reconstruction.gaussians.cloud import GaussianCloud

LEAST_DURATION = 1e-3  # clips; shorter is a flash between two planes
MOST_DURATION = 1e3  # clips; longer is always there


class Instantaneous(NamedTuple):
    """What the renderer takes: opacities are in [0, 1], after the gate; the rest is encoded as in the cloud."""

    means: Tensor  # [N + M, 3]
    quats_wxyz: Tensor  # [N + M, 4]
    log_scales: Tensor  # [N + M, 3]
    opacities: Tensor  # [N + M]
    intensities: Tensor  # [N + M, C]


@dataclass(frozen=True)
class Clip:
    """The span of the rig clock a model covers, in seconds."""

    first_s: float
    last_s: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.first_s) and self.last_s > self.first_s):
            raise ReconstructionError(
                f"found a clip from {self.first_s} to {self.last_s} s, expected a positive length"
            )

    def fraction(self, instant_s: float) -> float:
        """The instant in clips."""
        return (instant_s - self.first_s) / (self.last_s - self.first_s)


@dataclass
class Motion:
    """Straight motion of M Gaussians: velocities [M, 3] in m per clip, instants [M] and log_durations [M] in clips."""

    velocities: Tensor
    instants: Tensor
    log_durations: Tensor

    @classmethod
    def at_rest(cls, instants: Tensor, duration: float) -> Motion:
        """No velocity yet; each alive around its instant for about `duration` clips."""
        logs = torch.full_like(instants, math.log(duration))
        return cls(torch.zeros(len(instants), 3, dtype=instants.dtype), instants.clone(), logs)


@dataclass
class DynamicCloud:
    """`still` [N] and `moving` [M] with its `motion`, over `clip`."""

    still: GaussianCloud
    moving: GaussianCloud
    motion: Motion
    clip: Clip

    def __len__(self) -> int:
        return len(self.still) + len(self.moving)

    def at(self, instant_s: float) -> Instantaneous:
        """The cloud at one instant of the rig clock; differentiable in everything stored."""
        still, moving = self.still, self.moving
        if len(moving) == 0:
            return Instantaneous(
                still.means, still.quats_wxyz, still.log_scales, still.opacity_logits.sigmoid(), still.intensities
            )
        since = self.clip.fraction(instant_s) - self.motion.instants
        durations = self.motion.log_durations.clamp(math.log(LEAST_DURATION), math.log(MOST_DURATION)).exp()
        gate = torch.exp(-0.5 * (since / durations).square())
        return Instantaneous(
            torch.cat([still.means, moving.means + self.motion.velocities * since[:, None]]),
            torch.cat([still.quats_wxyz, moving.quats_wxyz]),
            torch.cat([still.log_scales, moving.log_scales]),
            torch.cat([still.opacity_logits.sigmoid(), moving.opacity_logits.sigmoid() * gate]),
            torch.cat([still.intensities, moving.intensities]),
        )

    def tensors(self) -> Iterator[tuple[str, Tensor]]:
        """Every stored tensor by a stable name, `still.means` to `motion.log_durations`."""
        for name in ("still", "moving", "motion"):
            for field, tensor in vars(getattr(self, name)).items():
                yield f"{name}.{field}", tensor

    def state(self) -> dict:
        """Plain tensors and numbers, for a checkpoint."""
        return {
            "clip": [self.clip.first_s, self.clip.last_s],
            "tensors": {k: v.detach().clone() for k, v in self.tensors()},
        }

    @classmethod
    def from_state(cls, state: dict) -> DynamicCloud:
        """The inverse of `state`."""
        parts: dict[str, dict[str, Tensor]] = {"still": {}, "moving": {}, "motion": {}}
        for name, tensor in state["tensors"].items():
            part, field = name.split(".")
            parts[part][field] = tensor
        first_s, last_s = state["clip"]
        return cls(
            GaussianCloud(**parts["still"]),
            GaussianCloud(**parts["moving"]),
            Motion(**parts["motion"]),
            Clip(first_s, last_s),
        )
