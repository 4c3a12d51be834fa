"""The Gaussians that training starts from, one for each point of a sweep."""

import math
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import MODELS, DynamicCloud
from reconstruction.gaussians.hexplane import HexPlaneMotion, box_around
from reconstruction.gaussians.motion_model import MotionModel
from reconstruction.gaussians.parts import parted
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.gaussians.spacetime import SpacetimeMotion
from reconstruction.gaussians.timesteps import TimestepMotion
from reconstruction.initialization.bodies import Bodies
from reconstruction.initialization.points import Points, Seeds, spacing
from reconstruction.initialization.sweep import depth_range_m
from reconstruction.scene_model import TimeSpan
from rigs.transform import Transform

STILL_OPACITY = 0.7
MOVING_OPACITY = 0.6
WIDTH = 0.5  # share of the gap to the neighbours: to grow is learnt faster than to shrink
LIFE = 1.0  # share of the gap between the instants at which movers were swept
LONG_LIFE = 2.0  # life in clips of Gaussians on a body that is seen all the time
ROOM = 10.0  # least reach of a field, in spacings of the points
LARGEST_M = 0.25  # largest size in m, so that a lone point does not cover everything


def seed_cloud(seeds: Seeds, *, cubic: bool = False) -> DynamicCloud:
    """Return Gaussians at rest that live around their own instants; `cubic` ones can bend their paths."""
    motion = PolynomialMotion.at_rest(_fractions(seeds.moving, seeds.clip), LIFE / seeds.instants, cubic=cubic)
    always = slice(len(seeds.moving) - seeds.resting, None)
    motion.instants[always], motion.log_durations[always] = 0.5, math.log(LONG_LIFE)
    return _cloud(seeds, motion)


def seed_spacetime(seeds: Seeds) -> DynamicCloud:
    """Return Gaussians as `seed_cloud` does that can also bend their paths and turn."""
    return _cloud(seeds, SpacetimeMotion.started(_fractions(seeds.moving, seeds.clip), LIFE / seeds.instants))


def seed_rigid(seeds: Seeds) -> DynamicCloud:
    """Return Gaussians that ride on their body for as long as it was seen; those without a body move straight."""
    bodies, instants = seeds.bodies(), seeds.instants
    order = np.concatenate([np.flatnonzero(bodies.owners >= 0), np.flatnonzero(bodies.owners < 0)])
    placed, owners = seeds.moving.select(order), bodies.owners[order]
    attached = int((owners >= 0).sum())
    centers = _fractions(placed, seeds.clip)
    durations = torch.full_like(centers, LIFE / instants)
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
    return _cloud(replace(seeds, moving=_in_bodies(placed, owners, bodies)), motion)


def seed_parts(seeds: Seeds) -> DynamicCloud:
    """Return Gaussians as `seed_rigid` does whose bodies are cut into parts, each of which learns its own motion."""
    return parted(seed_rigid(seeds))


def seed_field(seeds: Seeds, kind: str = HexPlaneMotion.kind) -> DynamicCloud:
    """Return canonical Gaussians deformed by a field of a `kind` of MODELS; no field where nothing moves."""
    if len(seeds.moving) == 0:
        return seed_cloud(replace(seeds, instants=1))
    model, least_m = MODELS[kind], ROOM * float(np.median(seeds.moving.spacing))
    assert issubclass(model, HexPlaneMotion)
    generator, brightness = torch.Generator().manual_seed(seeds.seed), float(np.mean(seeds.moving.intensities))
    return _cloud(seeds, model.over(box_around(_means(seeds.moving), least_m), generator, brightness))


def seed_timesteps(seeds: Seeds) -> DynamicCloud:
    """Return Gaussians of which the moving ones are at the first timestep."""
    return _cloud(seeds, TimestepMotion.started(_means(seeds.moving)))


def _cloud(seeds: Seeds, motion: MotionModel) -> DynamicCloud:
    still = _gaussians(seeds.still, STILL_OPACITY, _largest_m(seeds))
    moving = _gaussians(seeds.moving, MOVING_OPACITY, np.float64(LARGEST_M))
    return DynamicCloud(still, moving, motion, seeds.clip)


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


def _means(points: Points) -> Tensor:
    return torch.from_numpy(points.positions.astype(np.float32))


def _largest_m(seeds: Seeds) -> NDArray[np.float64]:
    """Return the largest size [N] of each still point: more beyond the usual depths, where a pixel is wider."""
    if not seeds.cameras:
        return np.full(len(seeds.still), LARGEST_M)
    center = np.mean([camera.center for camera in seeds.cameras], axis=0)
    away = np.linalg.norm(seeds.still.positions - center, axis=1)
    return LARGEST_M * np.maximum(1.0, away / depth_range_m(seeds.cameras)[1])


def _gaussians(points: Points, opacity: float, largest_m: NDArray[np.float64] | np.float64) -> GaussianCloud:
    sizes = np.clip(WIDTH * points.spacing, 1e-5, largest_m)
    scales = torch.from_numpy(np.log(sizes).astype(np.float32))
    light = torch.from_numpy(points.intensities.astype(np.float32))[:, None]
    return GaussianCloud.from_points(_means(points), light, scales, opacity)
