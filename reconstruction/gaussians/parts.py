"""Cuts rigid bodies into parts that learn a motion each, and joins the parts that turned out to move as one.

Noisy points at a few instants may put two things on one body; pictures tell them apart, once their parts have followed
those for a while. What bends stays in parts. Letters: K bodies or parts, A Gaussians that ride on them, P knots.
"""

from collections.abc import Sequence
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
Joint = tuple[Tensor, Tensor]  # quaternions [P, 4], no turn at the middle knot, and centres [P, 3] in m


class _Part(NamedTuple):
    """The places of a part: six points on its ellipsoid [P, 6, 3] in m at the knots, its Gaussians, its size in m."""

    points: Tensor
    riders: int
    size: float


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
    parts = [_part(cloud.moving, motion, body) for body in range(len(motion.knot_quats))]
    groups = _grouped(parts, gap_m)
    if len(groups) == len(parts):
        return cloud
    found = [_joint([parts[k] for k in group]) for group in groups]
    numbers = motion.bodies.new_zeros(len(parts))
    for number, group in enumerate(groups):
        numbers[group] = number
    joint = replace(
        motion,
        bodies=numbers[motion.bodies],
        knot_quats=torch.stack([quats for quats, _ in found]).to(motion.knot_quats),
        knot_centers=torch.stack([centers for _, centers in found]).to(motion.knot_centers),
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


def _part(moving: GaussianCloud, motion: RigidMotion, body: int) -> _Part:
    """Return where a body of `motion` is at the knots, in float64."""
    own = moving.means[: len(motion.bodies)][motion.bodies == body].double()
    knots = motion.knot_quats.shape[1]
    if not len(own):
        return _Part(own.new_zeros(knots, 6, 3), 0, 0.0)
    center = own.mean(dim=0)
    squares, axes = torch.linalg.eigh((own - center).T @ (own - center) / len(own))
    extents = (3 * squares).clamp_min(0).sqrt()  # so that means of squares over the six points are those of the part
    extents = extents.clamp_min(max(THICK * float(extents[-1]), TINY_M))
    points = torch.cat([center + (extents * axes).T, center - (extents * axes).T])
    turns = matrices(motion.knot_quats[body].double())
    places = points @ turns.mT + motion.knot_centers[body].double()[:, None]
    return _Part(places, len(own), float(extents[-1]))


def _joint(parts: Sequence[_Part]) -> Joint:
    """Return the rigid motion that follows the parts best, each by its Gaussians: a fit by Kabsch at every knot."""
    turns, centers, _ = _fit(parts)
    quats = [Transform(turn, np.zeros(3)).quat_wxyz for turn in turns.numpy()]
    return _in_one_hemisphere(torch.from_numpy(np.stack(quats))), centers


def _fit(parts: Sequence[_Part]) -> tuple[Tensor, Tensor, float]:
    """Return turns [P, 3, 3] and centres [P, 3] of all parts as one body, and how far it takes the worst part aside."""
    points = torch.cat([part.points for part in parts], dim=1)
    weights = points.new_tensor([part.riders for part in parts]).repeat_interleave(6)[:, None]
    weights = weights / weights.sum()
    centers = (weights * points).sum(dim=1)
    apart = points - centers[:, None]
    rest = apart[len(apart) // 2]
    left, _, right = torch.linalg.svd(apart.mT @ (weights * rest))
    signs = points.new_ones(len(left), 3)
    signs[:, 2] = torch.linalg.det(left @ right).sign()
    turns = (left * signs[:, None]) @ right
    aside = (rest @ turns.mT - apart).square().sum(dim=2).unflatten(1, (len(parts), 6))
    return turns, centers, float(aside.mean(dim=2).amax().sqrt())


def _grouped(parts: Sequence[_Part], gap_m: float) -> list[list[int]]:
    """Return the numbers of the parts that one body takes nowhere farther than `gap_m` aside, by the first of them."""
    groups = {k: [k] for k in range(len(parts))}
    gaps = {(a, b): _gap(parts, [a, b]) for a in groups for b in range(a) if _touch(parts[a], parts[b])}
    while gaps:
        (a, b), gap = min(gaps.items(), key=lambda pair: pair[1])
        if not gap <= gap_m:
            break
        others = {c for pair in gaps for c in pair if {a, b} & set(pair)} - {a, b}
        gaps = {pair: gap for pair, gap in gaps.items() if not {a, b} & set(pair)}
        groups[b] = sorted(groups[b] + groups.pop(a))
        gaps |= {(b, c): _gap(parts, groups[b] + groups[c]) for c in others}
    return sorted(groups.values())


def _gap(parts: Sequence[_Part], group: Sequence[int]) -> float:
    return _fit([parts[k] for k in group])[2]


def _touch(a: _Part, b: _Part) -> bool:
    """Return whether two parts that have Gaussians are neighbours at some knot."""
    apart = (a.points.mean(dim=1) - b.points.mean(dim=1)).norm(dim=1).amin()
    return min(a.riders, b.riders) > 0 and float(apart) <= NEAR * (a.size + b.size)


def _in_one_hemisphere(quats: Tensor) -> Tensor:
    """Return quaternions [P, 4] with each on the side of the one before."""
    flips = torch.where((quats[1:] * quats[:-1]).sum(dim=1) < 0, -1.0, 1.0).to(quats)
    return quats * torch.cat([flips.new_ones(1), flips]).cumprod(dim=0)[:, None]
