"""Poses from correspondences: differentiable, damped Gauss-Newton steps on residuals to the nominal rig.

A bundle adjustment whose points are the keypoints' inverse depths, each on its own ray, eliminated by their Schur
complement, as in DROID-SLAM (Teed and Deng, NeurIPS 2021), here with one focal factor, priors at the nominal rig and a
schedule that frees the turns first, the centres and the lens later, while the robust (Cauchy) scale comes down. The
residuals are whitened by the correspondences' own information. Letters: V = W views, N points a view, P = 6 V + 1
parameters: turn (rad, in camera axes) and shift (m) of each view, then the logarithm of the focal factor.
"""

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from reconstruction.networks.msdi.matching import Matches
from reconstruction.networks.msdi.views import FARTHEST, LEAST_Z, NEAREST, Views, cross_matrices, homogeneous

DEPTH_SD = 30.0  # deviation of an inverse depth, in object distances: holds free points
FIT_SD = 3.0  # standard deviations within which a correspondence agrees
DAMPING = 1e-6  # share of the diagonal that is added to it


class Stage(NamedTuple):
    """So many steps with these priors; `robust` in standard deviations of a correspondence."""

    steps: int
    robust: float
    shift_sd_m: float
    focal_sd: float
    turn_sd_rad: float = 0.05


SCHEDULE = (
    Stage(3, 30.0, 1e-4, 1e-5),
    Stage(3, 10.0, 1e-3, 1e-5),
    Stage(3, 5.0, 0.01, 0.01),
    Stage(8, 2.0, 0.02, 0.02),
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
    fits = _square(residual, matches.information) < FIT_SD**2
    used = matches.information.diagonal(dim1=-2, dim2=-1).sum(-1) > 0
    return Adjusted(views, inverse_depth, fits & used)


def moved(nominal: Views, parameters: Tensor) -> Views:
    """Return the views turned, shifted and refocused by `parameters` [P]."""
    turns, shifts = parameters[:-1].reshape(-1, 2, 3).unbind(dim=1)
    rotation = torch.linalg.matrix_exp(cross_matrices(turns)) @ nominal.rotation
    focal = nominal.focal * parameters[-1].exp()
    return replace(nominal, rotation=rotation, center=nominal.center + shifts, focal=focal)


def residuals(views: Views, matches: Matches, inverse_depth: Tensor) -> tuple[Tensor, Tensor]:
    """Return found less expected pixels [V, N, W, 2], and the points in the other views' axes [V, N, W, 3]."""
    seen = homogeneous(views, views, views.directions(matches.pixels), inverse_depth)
    xy = seen[..., :2] / seen[..., 2:].clamp_min(LEAST_Z)
    return matches.found - (xy * views.focal + views.principal), seen


class Slopes(NamedTuple):
    """Derivatives of the expected pixels [V, N, W, 2, ...]: by turn and shift of the view a point belongs to (`own`, 6)

    and of the view that sees it (`other`, 6), by the logarithm of the focal factor (`lens`) and by the inverse depth
    (`along`).
    """

    own: Tensor
    other: Tensor
    lens: Tensor
    along: Tensor


def _step(
    views: Views, matches: Matches, inverse_depth: Tensor, parameters: Tensor, stage: Stage
) -> tuple[Tensor, Tensor]:
    """Return one Gauss-Newton step of parameters [P] and inverse depths [V, N]."""
    residual, seen = residuals(views, matches, inverse_depth)
    slopes = derivatives(views, matches.pixels, inverse_depth, seen)
    doubt = 1 + _square(residual, matches.information).detach() / stage.robust**2
    ahead = (seen[..., 2] > LEAST_Z).to(doubt)
    weight = matches.information * (ahead / doubt)[..., None, None]
    normal, right, mixed = _normal_equations(slopes, weight, residual)
    along = (weight @ slopes.along[..., None])[..., 0]
    firm = (views.distance / DEPTH_SD) ** 2
    depth_normal = (along * slopes.along).sum(dim=(2, 3)) + firm
    depth_right = (along * residual).sum(dim=(2, 3)) + (1 / views.distance - inverse_depth) * firm
    view = [stage.turn_sd_rad**-2] * 3 + [stage.shift_sd_m**-2] * 3
    prior = torch.tensor(view * len(views) + [stage.focal_sd**-2], dtype=torch.float64).to(normal)
    normal = normal + torch.diag(prior + DAMPING * normal.diagonal().detach())
    right = right - prior * parameters
    scaled = (mixed / depth_normal[..., None]).flatten(0, 1)
    schur = normal - scaled.T @ mixed.flatten(0, 1)
    step = torch.linalg.solve(schur, right - scaled.T @ depth_right.flatten())
    return step, (depth_right - mixed @ step) / depth_normal


def _normal_equations(slopes: Slopes, weight: Tensor, residual: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return J'WJ [P, P] and J'Wr [P] of the parameters, and J'W times the slope along the ray [V, N, P]."""
    count = len(weight)
    own, other, lens = slopes.own, slopes.other, slopes.lens[..., None]
    weighted_own, weighted_other, weighted_lens = (weight @ part for part in (own, other, lens))
    diagonal = torch.einsum("vnwap,vnwaq->vpq", weighted_own, own)
    diagonal = diagonal + torch.einsum("vnwap,vnwaq->wpq", weighted_other, other)
    crossed = torch.einsum("vnwap,vnwaq->vwpq", weighted_own, other)
    identity = torch.eye(count, dtype=weight.dtype)
    blocks = crossed + crossed.permute(1, 0, 3, 2) + identity[..., None, None] * diagonal[:, None]
    poses = blocks.permute(0, 2, 1, 3).reshape(6 * count, 6 * count)
    edge = torch.einsum("vnwap,vnwaq->vp", weighted_own, lens) + torch.einsum("vnwap,vnwaq->wp", weighted_other, lens)
    corner = (weighted_lens * lens).sum().reshape(1, 1)
    edge = edge.reshape(-1, 1)
    normal = torch.cat([torch.cat([poses, edge], dim=1), torch.cat([edge.T, corner], dim=1)])
    towards = torch.einsum("vnwap,vnwa->vp", weighted_own, residual)
    towards = towards + torch.einsum("vnwap,vnwa->wp", weighted_other, residual)
    right = torch.cat([towards.reshape(-1), (weighted_lens[..., 0] * residual).sum().reshape(1)])
    mixed = torch.einsum("vnwap,vnwa->vnwp", weighted_other, slopes.along)
    mixed_own = torch.einsum("vnwap,vnwa->vnp", weighted_own, slopes.along)
    mixed = mixed + identity[:, None, :, None] * mixed_own[:, :, None]
    mixed_lens = (weighted_lens[..., 0] * slopes.along).sum(dim=(2, 3))
    return normal, right, torch.cat([mixed.flatten(2), mixed_lens[..., None]], dim=-1)


def derivatives(views: Views, pixels: Tensor, inverse_depth: Tensor, seen: Tensor) -> Slopes:
    """Return how expected pixels change, of points at `pixels` [V, N, 2], `seen` [V, N, W, 3] in the others' axes."""
    directions = views.directions(pixels)
    z = seen[..., 2].clamp_min(LEAST_Z)
    slope = seen[..., :2] / z[..., None]
    flat = torch.eye(2, dtype=seen.dtype).expand(*z.shape, 2, 2)
    project = torch.cat([flat, -slope[..., None]], dim=-1) * (views.focal / z[..., None])[..., None]
    other_from_own = torch.einsum("wab,vcb->vwac", views.rotation, views.rotation)
    own_turn = torch.einsum("vwab,vnbc->vnwac", other_from_own, cross_matrices(directions))
    shift = (inverse_depth[:, :, None, None, None] * views.rotation).expand(own_turn.shape)
    squeezed = torch.cat([-directions[..., :2], torch.zeros_like(directions[..., :1])], dim=-1)
    refocus = torch.einsum("vwab,vnb->vnwa", other_from_own, squeezed)
    baseline = torch.einsum("wab,vwb->vwa", views.rotation, views.center[:, None] - views.center[None])
    return Slopes(
        own=project @ torch.cat([own_turn, shift], dim=-1),
        other=project @ torch.cat([-cross_matrices(seen), -shift], dim=-1),
        lens=(project @ refocus[..., None])[..., 0] + slope * views.focal,
        along=(project @ baseline[:, None, :, :, None])[..., 0],
    )


def _square(residual: Tensor, information: Tensor) -> Tensor:
    return torch.einsum("...a,...ab,...b->...", residual, information, residual)
