"""Poses from correspondences: differentiable, damped Gauss-Newton steps on residuals to the nominal rig.

A bundle adjustment whose points are the keypoints' inverse depths, each on its own ray, eliminated by their Schur
complement, as in DROID-SLAM (Teed and Deng, NeurIPS 2021), here with one focal factor, priors at the nominal rig and a
schedule that frees the turns first, the centres and the lens later, while the robust (Cauchy) scale comes down. The
residuals are whitened by the correspondences' own information. Letters: V = W views, N points a view, P = 6 V + 1
parameters: turn (rad, in camera axes) and shift (m) of each view, then the logarithm of the focal factor.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from reconstruction.initialization.msdi.matching import Matches
from reconstruction.initialization.msdi.views import FARTHEST, LEAST_Z, NEAREST, Views, homogeneous

TURN_SD_RAD = 0.05
DEPTH_SD = 3.0  # of an inverse depth, in object distances: keeps points that nothing holds
DAMPING = 1e-6  # of the diagonal


class Stage(NamedTuple):
    """So many steps with these priors; `robust` in standard deviations of a correspondence."""

    steps: int
    robust: float
    shift_sd_m: float
    focal_sd: float


SCHEDULE = (
    Stage(3, 30.0, 1e-4, 1e-5),
    Stage(3, 10.0, 1e-3, 1e-5),
    Stage(3, 5.0, 0.01, 0.01),
    Stage(4, 2.0, 0.02, 0.02),
)


class Adjusted(NamedTuple):
    """The views moved, the inverse depth [V, N] of each keypoint, and which correspondences fit it [V, N, W]."""

    views: Views
    inverse_depth: Tensor
    fits: Tensor


def adjust(nominal: Views, matches: Matches, schedule: tuple[Stage, ...] = SCHEDULE) -> Adjusted:
    """Turn, shift and refocus the `nominal` views until the matches agree; in double precision, gradients pass.

    Views without a correspondence stay where the priors hold them.
    """
    nominal = nominal.to(torch.float64)
    matches = Matches(*(part.double() for part in matches))
    views, parameters = nominal, nominal.center.new_zeros(6 * len(nominal) + 1)
    inverse_depth = torch.full_like(matches.pixels[..., 0], 1 / nominal.distance)
    bounds = (1 / (FARTHEST * nominal.distance), 1 / (NEAREST * nominal.distance))
    for stage in schedule:
        for _ in range(stage.steps):
            step, deeper = _step(views, matches, inverse_depth, parameters, stage)
            parameters = parameters + step
            views = moved(nominal, parameters)
            inverse_depth = (inverse_depth + deeper).clamp(*bounds)
    residual, _ = residuals(views, matches, inverse_depth)
    fits = _square(residual, matches.information) < schedule[-1].robust ** 2
    used = matches.information.diagonal(dim1=-2, dim2=-1).sum(-1) > 0
    return Adjusted(views, inverse_depth, fits & used)


def moved(nominal: Views, parameters: Tensor) -> Views:
    """The views turned, shifted and refocused by `parameters` [P]."""
    turns, shifts = parameters[:-1].reshape(-1, 2, 3).unbind(dim=1)
    rotation = torch.linalg.matrix_exp(_cross(turns)) @ nominal.rotation
    return Views(
        rotation, nominal.center + shifts, nominal.focal * parameters[-1].exp(), nominal.principal, nominal.distance
    )


def residuals(views: Views, matches: Matches, inverse_depth: Tensor) -> tuple[Tensor, Tensor]:
    """Found less expected [V, N, W, 2] in px, and the points in the other views' axes [V, N, W, 3]."""
    seen = homogeneous(views, views, views.directions(matches.pixels), inverse_depth)
    xy = seen[..., :2] / seen[..., 2:].clamp_min(LEAST_Z)
    return matches.found - (xy * views.focal + views.principal), seen


def _step(
    views: Views, matches: Matches, inverse_depth: Tensor, parameters: Tensor, stage: Stage
) -> tuple[Tensor, Tensor]:
    """One Gauss-Newton step of parameters [P] and inverse depths [V, N]."""
    residual, seen = residuals(views, matches, inverse_depth)
    jacobian, along = _jacobians(views, matches.pixels, inverse_depth, seen)
    doubt = 1 + _square(residual, matches.information).detach() / stage.robust**2
    ahead = (seen[..., 2] > LEAST_Z).to(doubt)
    weight = matches.information * (ahead / doubt)[..., None, None]
    weighted = torch.einsum("vnwab,vnwbp->vnwap", weight, jacobian)
    weighted_along = torch.einsum("vnwab,vnwb->vnwa", weight, along)
    normal = torch.einsum("vnwap,vnwaq->pq", weighted, jacobian)
    right = torch.einsum("vnwap,vnwa->p", weighted, residual)
    mixed = torch.einsum("vnwap,vnwa->vnp", weighted, along)
    depth_right = torch.einsum("vnwa,vnwa->vn", weighted_along, residual)
    depth_right = depth_right + (1 / views.distance - inverse_depth) * (views.distance / DEPTH_SD) ** 2
    depth_normal = torch.einsum("vnwa,vnwa->vn", weighted_along, along) + (views.distance / DEPTH_SD) ** 2
    prior = _prior(len(views), stage).to(normal)
    normal = normal + torch.diag(prior + DAMPING * normal.diagonal().detach())
    right = right - prior * parameters
    scaled = mixed / depth_normal[..., None]
    schur = normal - torch.einsum("vnp,vnq->pq", scaled, mixed)
    step = torch.linalg.solve(schur, right - torch.einsum("vnp,vn->p", scaled, depth_right))
    return step, (depth_right - mixed @ step) / depth_normal


def _jacobians(views: Views, pixels: Tensor, inverse_depth: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
    """Of the expected pixels, by the parameters [V, N, W, 2, P] and by the inverse depth [V, N, W, 2]."""
    count = len(views)
    directions = views.directions(pixels)
    z = seen[..., 2].clamp_min(LEAST_Z)
    slope = seen[..., :2] / z[..., None]
    focal = views.focal
    project = torch.zeros(*seen.shape[:-1], 2, 3, dtype=seen.dtype)
    project[..., 0, 0], project[..., 1, 1] = 1 / z, 1 / z
    project[..., 2] = -slope / z[..., None]
    project = project * focal[:, :, None]
    other_from_own = torch.einsum("wab,vcb->vwac", views.rotation, views.rotation)
    own_turn = torch.einsum("vwab,vnbc->vnwac", other_from_own, _cross(directions))
    other_turn = -_cross(seen)
    shift = inverse_depth[:, :, None, None, None] * views.rotation[None, None]
    squeezed = torch.cat([-directions[..., :2], torch.zeros_like(directions[..., :1])], dim=-1)
    refocus = torch.einsum("vwab,vnb->vnwa", other_from_own, squeezed)
    shift = shift.expand(own_turn.shape)
    own = project @ torch.cat([own_turn, shift], dim=-1)
    others = project @ torch.cat([other_turn, -shift], dim=-1)
    identity = torch.eye(count, dtype=seen.dtype)
    placed = torch.einsum("vnwak,vq->vnwaqk", own, identity) + torch.einsum("vnwak,wq->vnwaqk", others, identity)
    lens = (project @ refocus[..., None])[..., 0] + slope * focal
    baseline = torch.einsum("wab,vwb->vwa", views.rotation, views.center[:, None] - views.center[None])
    along = (project @ baseline[:, None, :, :, None])[..., 0]
    return torch.cat([placed.flatten(-2), lens[..., None]], dim=-1), along


def _prior(count: int, stage: Stage) -> Tensor:
    view = [TURN_SD_RAD**-2] * 3 + [stage.shift_sd_m**-2] * 3
    return torch.tensor(view * count + [stage.focal_sd**-2], dtype=torch.float64)


def _square(residual: Tensor, information: Tensor) -> Tensor:
    return torch.einsum("...a,...ab,...b->...", residual, information, residual)


def _cross(vectors: Tensor) -> Tensor:
    """Matrices [..., 3, 3] that multiply as the cross product with `vectors` [..., 3] does."""
    x, y, z = vectors.unbind(dim=-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
