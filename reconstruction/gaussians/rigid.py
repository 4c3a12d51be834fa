"""Gaussians that ride on a few rigid bodies, so that every plane of the clip teaches the whole of a mover.

Letters: K bodies, P knots, A attached of M Gaussians; the other M - A are free and move in straight lines. An attached
one may drift beside its body, straight too, where the body bends or is none. Knots are even over the clip, 0 to 1.
Between them a body's centre and its quaternion follow Catmull-Rom's cubic, which passes through the knots with a
continuous velocity; the quaternion is then made unit. Outside the clip a body stays where it is at the clip's end.
Knots must be so dense that a body turns by less than a quarter from one to the next. Attached Gaussians are stored in
their body's frame. Source: Wang et al., "Shape of motion", 2024 (SE(3) bases that Gaussians share); here each Gaussian
follows a single one.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.course import Course, evaluated
from reconstruction.gaussians.motion_model import MotionModel
from reconstruction.gaussians.polynomial import WINDOW_RATES
from reconstruction.gaussians.riding import carried
from reconstruction.quaternions import unit
from reconstruction.rendering.result import Instantaneous
from reconstruction.scene_model import Rate


@dataclass
class RigidMotion(MotionModel):
    """The first A Gaussians ride on body `bodies`; all have a time window as in `PolynomialMotion`."""

    kind = "bases"
    rates: ClassVar[Mapping[str, Rate]] = {
        "knot_quats": Rate(5e-4),
        "knot_centers": Rate(1e-4, "scene"),
        "velocities": Rate(3e-3, "scene"),
        "drifts": Rate(1e-3, "scene"),
        **WINDOW_RATES,
    }
    bodies: Tensor  # [A] int64, 0 to K - 1
    knot_quats: Tensor  # [K, P, 4] wxyz, rig from body, neighbours in one hemisphere
    knot_centers: Tensor  # [K, P, 3] m, rig frame
    velocities: Tensor  # [M - A, 3] m per clip, of the free ones
    instants: Tensor  # [M] clips
    log_durations: Tensor  # [M] log clips
    drifts: Tensor = field(default_factory=lambda: torch.zeros(0, 3))  # [A, 3] m per clip, of the attached ones

    def __post_init__(self) -> None:
        if not len(self.drifts):
            self.drifts = self.velocities.new_zeros(len(self.bodies), 3)

    def poses(self, u: float) -> tuple[Tensor, Tensor]:
        """Return unit quaternions [K, 4] and centres [K, 3] in m of all bodies at u."""
        weights = knot_weights(u, self.knot_quats.shape[1]).to(self.knot_quats)
        quats = torch.einsum("p,kpi->ki", weights, self.knot_quats)
        return unit(quats), torch.einsum("p,kpi->ki", weights, self.knot_centers)

    def at(self, moving: GaussianCloud, u: float) -> Instantaneous:
        """Return the attached Gaussians where bodies and drifts take them, and the free ones along their lines."""
        riders = len(self.bodies)
        places, quats = carried(moving.means[:riders], moving.quats_wxyz[:riders], self.bodies, *self.poses(u))
        starts = torch.cat([places, moving.means[riders:]])
        velocities = torch.cat([self.drifts, self.velocities])
        course = Course(starts, moving.opacity_logits, self.instants, self.log_durations, (velocities,))
        means, opacities = evaluated(course, u)
        quats = torch.cat([quats, moving.quats_wxyz[riders:]])
        return Instantaneous(means, quats, moving.log_scales, opacities, moving.intensities)


def knot_weights(u: float, knots: int) -> Tensor:
    """Return Catmull-Rom weights [P] of even knots at u, as if the first and the last interval went on straight."""
    weights = torch.zeros(knots, dtype=torch.float64)
    if knots == 1:
        return weights + 1
    place = min(max(u, 0.0), 1.0) * (knots - 1)
    left = min(math.floor(place), knots - 2)
    s = place - left
    cubic = (-s + 2 * s**2 - s**3, 2 - 5 * s**2 + 3 * s**3, s + 4 * s**2 - 3 * s**3, s**3 - s**2)
    for knot, weight in zip(range(left - 1, left + 3), cubic, strict=True):
        if knot < 0:  # the knot before the first: 2 first - second
            weights[0] += weight
            weights[1] -= weight / 2
        elif knot >= knots:
            weights[-1] += weight
            weights[-2] -= weight / 2
        else:
            weights[knot] += weight / 2
    return weights
