"""Gaussians that ride on a few rigid bodies: what a mover shows in any plane of the clip teaches all of it.

Letters: K bodies, P knots, A attached of M Gaussians; the other M - A are free and move in straight lines. Knots are
even over the clip, 0 to 1. Between them a body's centre and its quaternion follow Catmull-Rom's cubic (through the
knots, with a continuous velocity), the quaternion made unit afterwards; outside the clip a body stays where it was at
its end. Knots must lie so dense that a body turns less than a quarter from one to the next. Attached Gaussians are
stored in their body's frame. Source: Wang et al., "Shape of motion", 2024 (shared SE(3) bases); here one a Gaussian.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.motion import Instantaneous, MotionModel, gate


@dataclass
class RigidMotion(MotionModel):
    """The first A Gaussians ride on body `bodies`; all have a time window as in `Motion`."""

    kind = "bases"
    fixed = frozenset({"bodies"})
    bodies: Tensor  # [A] int64, 0 to K - 1
    knot_quats: Tensor  # [K, P, 4] wxyz, rig from body, neighbours in one hemisphere
    knot_centers: Tensor  # [K, P, 3] m, rig frame
    velocities: Tensor  # [M - A, 3] m per clip, of the free ones
    instants: Tensor  # [M] clips
    log_durations: Tensor  # [M] log clips

    def poses(self, u: float) -> tuple[Tensor, Tensor]:
        """Unit quaternions [K, 4] and centres [K, 3] of all bodies at u."""
        weights = knot_weights(u, self.knot_quats.shape[1]).to(self.knot_quats)
        quats = torch.einsum("p,kpi->ki", weights, self.knot_quats)
        return unit(quats), torch.einsum("p,kpi->ki", weights, self.knot_centers)

    def at(self, moving: GaussianCloud, u: float) -> Instantaneous:
        """Attached ones carried and turned by their body, free ones moved along."""
        attached = len(self.bodies)
        quats, centers = (poses[self.bodies] for poses in self.poses(u))
        free = slice(attached, None)
        carried = rotated(quats, moving.means[:attached]) + centers
        moved = moving.means[free] + self.velocities * (u - self.instants[free])[:, None]
        turned = product(quats, moving.quats_wxyz[:attached])
        return Instantaneous(
            torch.cat([carried, moved]),
            torch.cat([turned, moving.quats_wxyz[free]]),
            moving.log_scales,
            moving.opacity_logits.sigmoid() * gate(u, self.instants, self.log_durations),
            moving.intensities,
        )


def knot_weights(u: float, knots: int) -> Tensor:
    """Catmull-Rom weights [P] of even knots at u; a knot before the first or after the last goes on straight."""
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


def unit(quats_wxyz: Tensor) -> Tensor:
    """Quaternions [K, 4] of any length made unit; no turn where all four numbers are zero."""
    largest = quats_wxyz.detach().abs().amax(dim=-1, keepdim=True)
    some = largest > 0
    # Scaled first, so that 1e20 and 1e-20 survive the squares.
    scaled = torch.where(some, quats_wxyz / torch.where(some, largest, 1), quats_wxyz.new_tensor([1.0, 0, 0, 0]))
    return scaled / scaled.norm(dim=-1, keepdim=True)


def rotated(quats_wxyz: Tensor, vectors: Tensor) -> Tensor:
    """`vectors` [M, 3] turned by unit quaternions [M, 4]."""
    real, axis = quats_wxyz[:, :1], quats_wxyz[:, 1:]
    across = 2 * torch.linalg.cross(axis, vectors)
    return vectors + real * across + torch.linalg.cross(axis, across)


def product(left: Tensor, right: Tensor) -> Tensor:
    """Hamilton's product [M, 4] of quaternions wxyz: `right` first, then `left`."""
    a, u = left[:, :1], left[:, 1:]
    b, v = right[:, :1], right[:, 1:]
    real = a * b - (u * v).sum(-1, keepdim=True)
    return torch.cat([real, a * v + b * u + torch.linalg.cross(u, v)], dim=-1)
