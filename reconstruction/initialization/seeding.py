"""The Gaussians that training starts from, one for each point of a sweep.

`still` and `moving` are the points of the still scene and of movers, which were swept at `instants` moments of `clip`.
"""

import numpy as np
import torch
from torch import Tensor

from reconstruction.gaussians.canonical import CanonicalMotion
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.hexplane import HexPlaneMotion
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.gaussians.spacetime import SpacetimeMotion
from reconstruction.gaussians.timesteps import TimestepMotion
from reconstruction.initialization.bodies import Bodies
from reconstruction.initialization.points import Points, spacing
from reconstruction.scene_model import TimeSpan
from rigs.transform import Transform

STILL_OPACITY = 0.7
MOVING_OPACITY = 0.6
WIDTH = 0.5  # share of the gap to the neighbours: to grow is learnt faster than to shrink
LIFE = 1.0  # share of the gap between the instants at which movers were swept
LONG_LIFE = 2.0  # life in clips of Gaussians on a body that is seen all the time
ROOM = 10.0  # least reach of a field, in spacings of the points
LARGEST_M = 0.25  # largest size in m, so that a lone point does not cover everything


def seed_cloud(still: Points, moving: Points, clip: TimeSpan, instants: int, *, cubic: bool = False) -> DynamicCloud:
    """Return Gaussians at rest that live around their own instants; `cubic` ones can bend their paths."""
    motion = PolynomialMotion.at_rest(_fractions(moving, clip), duration=LIFE / instants, cubic=cubic)
    return DynamicCloud(_gaussians(still, STILL_OPACITY), _gaussians(moving, MOVING_OPACITY), motion, clip)


def seed_spacetime(still: Points, moving: Points, clip: TimeSpan, instants: int) -> DynamicCloud:
    """Return Gaussians as `seed_cloud` does that can also bend their paths and turn."""
    motion = SpacetimeMotion.started(_fractions(moving, clip), LIFE / instants)
    return DynamicCloud(_gaussians(still, STILL_OPACITY), _gaussians(moving, MOVING_OPACITY), motion, clip)


def seed_rigid(still: Points, moving: Points, clip: TimeSpan, instants: int, bodies: Bodies) -> DynamicCloud:
    """Return Gaussians that ride on their body for as long as it was seen; those without a body move straight."""
    order = np.concatenate([np.flatnonzero(bodies.owners >= 0), np.flatnonzero(bodies.owners < 0)])
    placed, owners = moving.select(order), bodies.owners[order]
    attached = int((owners >= 0).sum())
    centers = _fractions(placed, clip)
    durations = torch.full_like(centers, LIFE / instants)
    carried = _in_bodies(placed, owners, bodies)
    for k, (first, last) in enumerate(bodies.seen):
        own = torch.from_numpy(owners == k)
        centers[own] = float(first + last + 1) / (2 * instants)
        durations[own] = LONG_LIFE if last - first == instants - 1 else float(last - first + 1) / (2 * instants)
    motion = RigidMotion(
        torch.from_numpy(owners[:attached]),
        _knots(bodies.quats_wxyz),
        _knots(bodies.centers),
        torch.zeros(len(placed) - attached, 3),
        centers,
        durations.log(),
    )
    return DynamicCloud(_gaussians(still, STILL_OPACITY), _gaussians(carried, MOVING_OPACITY), motion, clip)


def seed_field(
    still: Points, moving: Points, clip: TimeSpan, seed: int, model: type[CanonicalMotion] = HexPlaneMotion
) -> DynamicCloud:
    """Return canonical Gaussians deformed by a field that starts from `seed`; no field where nothing moves."""
    if len(moving) == 0:
        return seed_cloud(still, moving, clip, 1)
    canonical = _gaussians(moving, MOVING_OPACITY)
    least_m = ROOM * float(np.median(moving.spacing))
    motion = model.around(canonical.means, least_m, torch.Generator().manual_seed(seed))
    return DynamicCloud(_gaussians(still, STILL_OPACITY), canonical, motion, clip)


def seed_timesteps(still: Points, moving: Points, clip: TimeSpan) -> DynamicCloud:
    """Return Gaussians of which the moving ones are at the first timestep."""
    canonical = _gaussians(moving, MOVING_OPACITY)
    motion = TimestepMotion.started(canonical.means)
    return DynamicCloud(_gaussians(still, STILL_OPACITY), canonical, motion, clip)


def _in_bodies(points: Points, owners: np.ndarray, bodies: Bodies) -> Points:
    """Return the points with those of a body in its frame, spaced as all points of the body are together there."""
    positions, gaps = points.positions.copy(), points.spacing.copy()
    for k in range(len(bodies)):
        for i, instant_s in enumerate(bodies.instants_s):
            own = (owners == k) & (points.instants_s == instant_s)
            rig_from_body = Transform.from_quat_wxyz(bodies.quats_wxyz[k, i], bodies.centers[k, i])
            positions[own] = rig_from_body.inverse().apply(points.positions[own])
        gaps[owners == k] = spacing(positions[owners == k])
    return Points(positions, points.intensities, gaps, points.instants_s)


def _knots(values: np.ndarray) -> Tensor:
    """Return knots [K, 2 I + 1, D] at the borders and in the middles of I equal parts, from values [K, I, D] there."""
    if values.shape[1] == 1:
        return torch.from_numpy(np.repeat(values, 3, axis=1).astype(np.float32))
    before, after = 2 * values[:, :1] - values[:, 1:2], 2 * values[:, -1:] - values[:, -2:-1]
    padded = np.concatenate([2 * before - values[:, :1], before, values, after, 2 * after - values[:, -1:]], axis=1)
    between = (9 * (padded[:, 1:-2] + padded[:, 2:-1]) - padded[:, :-3] - padded[:, 3:]) / 16
    knots = np.empty((len(values), 2 * values.shape[1] + 1, values.shape[2]))
    knots[:, 1::2], knots[:, ::2] = values, between
    return torch.from_numpy(knots.astype(np.float32))


def _fractions(points: Points, clip: TimeSpan) -> Tensor:
    return torch.tensor([clip.fraction(s) for s in points.instants_s], dtype=torch.float32)


def _gaussians(points: Points, opacity: float) -> GaussianCloud:
    count = len(points)
    scales = np.log(np.clip(WIDTH * points.spacing, 1e-5, LARGEST_M))
    quats = torch.zeros(count, 4)
    quats[:, 0] = 1
    return GaussianCloud(
        means=torch.from_numpy(points.positions.astype(np.float32)),
        quats_wxyz=quats,
        log_scales=torch.from_numpy(np.repeat(scales[:, None], 3, axis=1).astype(np.float32)),
        opacity_logits=torch.full((count,), float(np.log(opacity / (1 - opacity)))),
        intensities=torch.from_numpy(points.intensities.astype(np.float32))[:, None],
    )
