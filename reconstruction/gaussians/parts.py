"""Cuts rigid bodies into parts that learn a motion each, and joins the parts that turned out to move as one.

Noisy points at a few instants may put two things on one body; pictures tell them apart, once their parts have followed
those for a while. What bends stays in parts.
Letters: K bodies or parts, A Gaussians that ride on them, P knots, B groups of parts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.riding import carried
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.quaternions import matrices, product, rotated, unit
from rigs.transform import Transform

RIDERS = 500  # most Gaussians of a part, where there are no more than MOST_PARTS of them
MOST_PARTS = 64
THICK = 0.1  # least extent of a part along any axis, over its largest: a thin rod shows how it rolls by its quaternion
NEAR = 1.5  # sizes apart at which neighbours touch
TINY_M = 1e-6
Pair = tuple[int, int]


class _Parts(NamedTuple):
    """The places of K parts: six points on the ellipsoid of each [K, P, 6, 3] in m, its Gaussians [K], its size [K]."""

    points: Tensor
    riders: Tensor
    sizes: Tensor  # m


class _Fits(NamedTuple):
    """Several parts as one body, for each of B groups.

    Turns [B, P, 3, 3] and centres [B, P, 3] in m at the knots, and how far they take the worst part aside [B] in m.
    """

    turns: Tensor
    centers: Tensor
    gaps: Tensor


@torch.no_grad()
def parted(cloud: DynamicCloud) -> DynamicCloud:
    """Return the cloud with bodies cut in half, again and again, until no part has more than RIDERS Gaussians.

    At the knots every Gaussian is where it was. Where RIDERS would give more than MOST_PARTS, parts are larger.
    """
    motion = cloud.motion
    assert isinstance(motion, RigidMotion)
    riders, places = len(motion.bodies), cloud.moving.means[: len(motion.bodies)]
    most = max(RIDERS, -(-riders // MOST_PARTS))
    if not riders or int(torch.bincount(motion.bodies).amax()) <= most:
        return cloud
    bodies, offsets = torch.zeros_like(motion.bodies), torch.zeros_like(places)
    quats, centers = [], []
    for body, (own_quats, own_centers) in enumerate(zip(motion.knot_quats, motion.knot_centers, strict=True)):
        for part in _halves(places, torch.nonzero(motion.bodies == body)[:, 0], most):
            offset = places[part].mean(dim=0)
            bodies[part], offsets[part] = len(quats), offset
            quats.append(own_quats)
            centers.append(own_centers + rotated(unit(own_quats), offset.expand(len(own_quats), 3)))
    means = torch.cat([places - offsets, cloud.moving.means[riders:]])
    cut = replace(motion, bodies=bodies, knot_quats=torch.stack(quats), knot_centers=torch.stack(centers))
    return replace(cloud, moving=replace(cloud.moving, means=means), motion=cut)


@torch.no_grad()
def joined(cloud: DynamicCloud, gap_m: float) -> DynamicCloud:
    """Return the cloud with neighbouring parts on one body wherever it takes none of them farther than `gap_m` aside.

    Pairs that agree best are joined first. Gaps are root mean squares over a part, at the worst knot. Each Gaussian
    stays where it is in the middle of the time that its part is seen.
    """
    motion = cloud.motion
    assert isinstance(motion, RigidMotion)
    if not len(motion.knot_quats):
        return cloud
    parts = _parts(cloud.moving, motion)
    groups = _grouped(parts, gap_m)
    if len(groups) == len(parts.riders):
        return cloud
    quats, centers = _joint(parts, groups)
    numbers = motion.bodies.new_zeros(len(parts.riders))
    for number, group in enumerate(groups):
        numbers[group] = number
    joint = replace(
        motion,
        bodies=numbers[motion.bodies],
        knot_quats=quats.to(motion.knot_quats),
        knot_centers=centers.to(motion.knot_centers),
    )
    return replace(cloud, moving=_carried_over(cloud.moving, motion, joint), motion=joint)


def _carried_over(moving: GaussianCloud, before: RigidMotion, after: RigidMotion) -> GaussianCloud:
    """Return the Gaussians in the frames of their bodies of `after`, each part where it is at its mean instant."""
    means, quats = moving.means.clone(), moving.quats_wxyz.clone()
    instants = before.instants[: len(before.bodies)].clamp(0, 1)
    for part in range(len(before.knot_quats)):
        own = torch.nonzero(before.bodies == part)[:, 0]
        if len(own):
            u = float(instants[own].mean())
            places, turns = carried(means[own], quats[own], before.bodies[own], *before.poses(u))
            body_quats, centers = (poses[after.bodies[own]] for poses in after.poses(u))
            back = body_quats * quats.new_tensor([1.0, -1, -1, -1])
            means[own], quats[own] = rotated(back, places - centers), product(back, turns)
    return replace(moving, means=means, quats_wxyz=quats)


def _halves(places: Tensor, which: Tensor, most: int) -> list[Tensor]:
    """Return the indices `which` into `places` in parts of at most `most`, each cut across its longest axis."""
    if len(which) <= most:
        return [which] if len(which) else []
    own = places[which].double()
    axis = torch.linalg.eigh((own - own.mean(dim=0)).T @ (own - own.mean(dim=0)))[1][:, -1]
    order = which[torch.argsort(own @ axis, stable=True)]
    half = len(order) // 2
    return [*_halves(places, order[:half], most), *_halves(places, order[half:], most)]


def _parts(moving: GaussianCloud, motion: RigidMotion) -> _Parts:
    """Return where the bodies of `motion` are at the knots, in float64."""
    means = moving.means[: len(motion.bodies)].double()
    found = [_on_ellipsoid(means[motion.bodies == body]) for body in range(len(motion.knot_quats))]
    points, sizes = (torch.stack(kind) for kind in zip(*found, strict=True))
    turns = matrices(motion.knot_quats.double())
    places = points[:, None] @ turns.mT + motion.knot_centers.double()[:, :, None]
    return _Parts(places, torch.bincount(motion.bodies, minlength=len(found)), sizes)


def _on_ellipsoid(own: Tensor) -> tuple[Tensor, Tensor]:
    """Return six points [6, 3] that are spread as the points [n, 3] are, and their size; zeros where there are none.

    The means of squares over the six points are those over all.
    """
    if not len(own):
        return own.new_zeros(6, 3), own.new_zeros(())
    center = own.mean(dim=0)
    squares, axes = torch.linalg.eigh((own - center).T @ (own - center) / len(own))
    extents = (3 * squares).clamp_min(0).sqrt()
    extents = extents.clamp_min(max(THICK * float(extents[-1]), TINY_M))
    return torch.cat([center + (extents * axes).T, center - (extents * axes).T]), extents[-1]


def _joint(parts: _Parts, groups: Sequence[Sequence[int]]) -> tuple[Tensor, Tensor]:
    """Return quaternions [B, P, 4], no turn at the middle knot, and centres [B, P, 3] in m that follow groups best."""
    fits = _fits(parts, groups)
    quats = [[Transform(turn, np.zeros(3)).quat_wxyz for turn in turns] for turns in fits.turns.numpy()]
    return torch.stack([_in_one_hemisphere(torch.from_numpy(np.stack(own))) for own in quats]), fits.centers


def _fits(parts: _Parts, groups: Sequence[Sequence[int]]) -> _Fits:
    """Return each group of parts as one body, its parts weighted by their Gaussians: a fit by Kabsch at every knot."""
    most = max(map(len, groups))
    members = torch.tensor([[*group, *[group[0]] * (most - len(group))] for group in groups])
    counts = torch.tensor(list(map(len, groups)))[:, None]
    weights = torch.where(torch.arange(most) < counts, parts.riders[members], 0).to(parts.points)
    weights = weights / (6 * weights.sum(dim=1, keepdim=True).clamp_min(1))  # six points a part
    weights = weights.repeat_interleave(6, dim=1)[:, None, :, None]
    points = parts.points[members].transpose(1, 2).flatten(2, 3)  # [B, P, 6 most, 3]
    centers = (weights * points).sum(dim=2)
    apart = points - centers[:, :, None]
    rest = apart[:, apart.shape[1] // 2, None]
    left, _, right = torch.linalg.svd(apart.mT @ (weights * rest))
    signs = points.new_ones(*left.shape[:2], 3)
    signs[..., 2] = torch.linalg.det(left @ right).sign()
    turns = (left * signs[..., None, :]) @ right
    aside = (rest @ turns.mT - apart).square().sum(dim=3).unflatten(2, (most, 6))
    return _Fits(turns, centers, aside.mean(dim=3).amax(dim=(1, 2)).sqrt())


def _grouped(parts: _Parts, gap_m: float) -> list[list[int]]:
    """Return the numbers of the parts that one body takes nowhere farther than `gap_m` aside, by the first of them."""
    groups = {k: [k] for k in range(len(parts.riders))}
    gaps = _gaps(parts, groups, _neighbours(parts))
    while gaps:
        (a, b), gap = min(gaps.items(), key=lambda pair: pair[1])
        if not gap <= gap_m:
            break
        others = {c for pair in gaps for c in pair if {a, b} & set(pair)} - {a, b}
        gaps = {pair: gap for pair, gap in gaps.items() if not {a, b} & set(pair)}
        groups[b] = sorted(groups[b] + groups.pop(a))
        gaps |= _gaps(parts, groups, [(b, c) for c in others])
    return sorted(groups.values())


def _gaps(parts: _Parts, groups: Mapping[int, list[int]], pairs: Sequence[Pair]) -> dict[Pair, float]:
    """Return how far one body for both groups of a pair would take the worst of their parts aside, in m."""
    if not pairs:
        return {}
    return dict(zip(pairs, _fits(parts, [groups[a] + groups[b] for a, b in pairs]).gaps.tolist(), strict=True))


def _neighbours(parts: _Parts) -> list[Pair]:
    """Return the pairs of parts that have Gaussians and are neighbours at some knot, the later part first."""
    middles = parts.points.mean(dim=2)
    apart = torch.cdist(middles.transpose(0, 1), middles.transpose(0, 1)).amin(dim=0)
    there = parts.riders > 0
    near = (apart <= NEAR * (parts.sizes[:, None] + parts.sizes)) & there[:, None] & there
    return [(a, b) for a, b in near.tril(-1).nonzero().tolist()]


def _in_one_hemisphere(quats: Tensor) -> Tensor:
    """Return quaternions [P, 4] with each on the side of the one before."""
    flips = torch.where((quats[1:] * quats[:-1]).sum(dim=1) < 0, -1.0, 1.0).to(quats)
    return quats * torch.cat([flips.new_ones(1), flips]).cumprod(dim=0)[:, None]
