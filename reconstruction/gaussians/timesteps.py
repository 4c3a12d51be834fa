"""Dynamic 3D Gaussians: one timestep of the clip after the other, each from where the last one ended.

Letters: M moving Gaussians, K timesteps, even over the clip from 0 to 1; k neighbours. The first timestep learns
everything. Each later one learns positions and quaternions alone: they start from the last ones plus their last change,
and `rigidity` holds them together. Between timesteps positions and unit quaternions are interpolated linearly; after
the newest one all stands still. The moving cloud itself holds the timestep that is being learnt.
Source: Luiten et al., "Dynamic 3D Gaussians", 3DV 2024.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.motion_model import MotionModel
from reconstruction.gaussians.rigidity import Neighbourhood, neighbourhood, rigidity
from reconstruction.quaternions import unit
from reconstruction.rendering.result import Instantaneous
from reconstruction.scene_model import Rate

TIMESTEPS = 13
FIRST = 0.4  # share of the training that the first timestep takes
WEIGHT = 5e-4  # weight of the rigidity losses


@dataclass
class TimestepMotion(MotionModel):
    """The learnt timesteps, and the neighbours at the first one; no gradient descent changes them."""

    kind = "d3dgs"
    rates: ClassVar[Mapping[str, Rate]] = {}
    past_means: Tensor  # [K, M, 3] m, rows from `current` on are not used
    past_quats: Tensor  # [K, M, 4] unit, likewise
    current: Tensor  # [] int64, the timestep that is being learnt
    indices: Tensor  # [M, k] int64, as in `Neighbourhood`
    weights: Tensor  # [M, k]
    distances: Tensor  # [M, k] m

    @classmethod
    def started(cls, means: Tensor) -> TimestepMotion:
        """Return a motion that is about to learn the first timestep of `means` [M, 3] in m."""
        past_means, past_quats = (means.new_zeros(TIMESTEPS, len(means), n) for n in (3, 4))
        return cls(past_means, past_quats, torch.tensor(0), *neighbourhood(means))

    def at(self, moving: GaussianCloud, u: float) -> Instantaneous:
        """Return the Gaussians between the timesteps beside u; after the first, only means and quats have gradients."""
        now = int(self.current)
        place = min(min(max(u, 0.0), 1.0) * (len(self.past_means) - 1), now)
        left = math.floor(place)
        (means, quats), (next_means, next_quats) = (self._key(moving, k) for k in (left, min(left + 1, now)))
        rest = (moving.log_scales, moving.opacity_logits, moving.intensities)
        log_scales, logits, intensities = (t.detach() for t in rest) if now else rest
        return Instantaneous(
            means.lerp(next_means, place - left),
            quats.lerp(next_quats, place - left),
            log_scales,
            logits.sigmoid(),
            intensities,
        )

    def _key(self, moving: GaussianCloud, k: int) -> tuple[Tensor, Tensor]:
        """Return means and unit quaternions of timestep k, which is not after the current one."""
        if k < int(self.current):
            return self.past_means[k], self.past_quats[k]
        return moving.means, unit(moving.quats_wxyz)

    def span(self) -> tuple[float, float]:
        """Return the u of the last timestep and of the current one; at the first, 0 and half a step."""
        now, steps = int(self.current), max(len(self.past_means) - 1, 1)
        return ((now - 1) / steps, now / steps) if now else (0.0, 0.5 / steps)

    @torch.no_grad()
    def advance(self, moving: GaussianCloud, done: float) -> float:
        """Go on to the timestep that is due after `done` (0 to 1) of the training; return how much of it is over."""
        steps = len(self.past_means) - 1
        if done < FIRST or not steps:
            return done / FIRST if steps else done
        place = min((done - FIRST) / (1 - FIRST), 1.0) * steps
        due = min(math.floor(place), steps - 1)
        while int(self.current) <= due:
            self._go_on(moving)
        return place - due

    def _go_on(self, moving: GaussianCloud) -> None:
        now, quats = int(self.current), unit(moving.quats_wxyz)
        self.past_means[now], self.past_quats[now] = moving.means, quats
        if now:
            moving.means += moving.means - self.past_means[now - 1]
            moving.quats_wxyz.copy_(unit(2 * quats - self.past_quats[now - 1]))
        else:
            self.indices, self.weights, self.distances = neighbourhood(moving.means)
        self.current += 1

    def penalty(self, moving: GaussianCloud) -> Tensor | None:
        """Return the loss of rigidity against the last timestep, None at the first."""
        now = int(self.current)
        if now == 0 or self.indices.numel() == 0:
            return None
        near = Neighbourhood(self.indices, self.weights, self.distances)
        return WEIGHT * rigidity(near, self._key(moving, now - 1), self._key(moving, now))
