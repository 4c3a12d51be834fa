"""Finds the transform between two samples of one rigid surface, without knowing which point is which.

Letters: n points of the target, m of the model. Every target point is matched softly with all model points, by distance
and by brightness, or with none; the rigid fit to the matches is closed form; the width of the matches follows the
residuals down to `floor`. Cost: n x m a round, so both are thinned to MOST_POINTS. Needs a guess within a few widths.
Sources: Myronenko & Song, "Point set registration: coherent point drift", PAMI 2010; Umeyama, PAMI 1991 (the fit).
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from acquisition.native import Address
from reconstruction.initialization.points import Points, nearest
from reconstruction.native import Double, Int, kernel
from rigs.transform import Transform

MOST_POINTS = 400  # points of either sample
ROUNDS = 20  # most rounds of matching and fitting
STRAY = 0.2  # share of the target that is expected to have no partner
CROWDING = 0.1  # share of the volume around points that holds any: they lie on surfaces
LEAST_MATCHED = 3.0  # sum of all matches below which there is nothing to fit
MOST_UNLIKE = 40.0  # exponent beyond which a match is none
ALIKE = 0.04  # spikes per tick by which the brightness of one surface point differs at two instants

Cloud = tuple[NDArray[np.float32], NDArray[np.float32]]  # positions [n, 3] in m, intensities [n] in spikes per tick

_link_points = kernel("link_points", Address, Int, Double, Address)
_soft_matches = kernel("soft_matches", *[Address, Address, Int] * 2, Address, *[Double] * 4, Address)


@dataclass(frozen=True, eq=False)
class Matches:
    """Sums over all pairs: of a match between 0 and 1, and of a match times what the field names."""

    total: float
    squared: float  # m^2, of the distances
    model: NDArray[np.float64]  # [3] m
    target: NDArray[np.float64]  # [3] m
    cross: NDArray[np.float64]  # [3, 3] m^2, target by model


def sampled(points: Points) -> Points:
    """Return at most MOST_POINTS points, evenly spread over their order."""
    if len(points) <= MOST_POINTS:
        return points
    return points.select(np.linspace(0, len(points) - 1, MOST_POINTS).astype(np.int64))


def linked(positions: NDArray[np.floating], gap_m: float) -> NDArray[np.int32]:
    """Return the number of each point's cluster [n], from 0 in the order of their first points.

    Points [n, 3] within `gap_m` of each other are of one cluster, and so are those that others join.
    """
    numbers = np.empty(len(positions), np.int32)
    _link_points(np.ascontiguousarray(positions, dtype=np.float64), len(positions), gap_m, numbers)
    return numbers


def nearest_of(points: Points, others: Points) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return for each of n points the distance [n] in m to the nearest of the others, and the index [n] of that one."""
    apart, which = nearest(points.positions, others.positions)
    return apart[:, 0], which[:, 0]


def register(model: Points, target: Points, guess: Transform, width: float, floor: float) -> Transform:
    """Return target from model, begun at `guess` with matches `width` metres wide, which narrow to half of `floor`."""
    pose = guess
    volume = float(torch.from_numpy(np.ptp(target.positions, axis=0)).clamp_min(floor).prod())
    lever = float(torch.from_numpy(model.positions).norm(dim=1).amax())
    model_cloud, target_cloud = ((p.positions, p.intensities) for p in (model, target))
    for _ in range(ROUNDS):
        stray = STRAY / (1 - STRAY) * len(model) * CROWDING * (2 * np.pi) ** 1.5 * width**3 / volume
        matches = soft_matches(model_cloud, target_cloud, pose, width, stray)
        if matches.total < LEAST_MATCHED:
            break
        found = rigid_fit(matches)
        turned = float(np.linalg.norm(found.rotation - pose.rotation))
        moved = float(np.linalg.norm(found.translation - pose.translation)) + lever * turned  # of the farthest point
        still = moved < 1e-3 * floor
        pose = found
        residual = (matches.squared / (3 * matches.total)) ** 0.5
        narrowed = max(floor / 2, min(width * 0.8, residual))
        if still and narrowed == width:
            break
        width = narrowed
    return pose


def soft_matches(model: Cloud, target: Cloud, pose: Transform, width: float, stray: float) -> Matches:
    """Match every target point with all model points where `pose` carries the model to the target.

    Matches are `width` metres wide; `stray` weighs having none.
    """
    at, light, target_at, target_light = (np.ascontiguousarray(a, dtype=np.float32) for a in (*model, *target))
    numbers = np.concatenate([pose.rotation.ravel(), pose.translation]).astype(np.float64)
    sums = np.empty(17)
    _soft_matches(
        at, light, len(at), target_at, target_light, len(target_at), numbers, width, ALIKE, MOST_UNLIKE, stray, sums
    )
    return Matches(float(sums[0]), float(sums[1]), sums[2:5], sums[5:8], sums[8:].reshape(3, 3))


def rigid_fit(matches: Matches) -> Transform:
    """Return the pose that brings the model nearest to the target in the squares weighted by the matches."""
    middle_model, middle_target = matches.model / matches.total, matches.target / matches.total
    left, _, right = np.linalg.svd(matches.cross - np.outer(middle_target, matches.model))
    mirror = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    turn = left @ (mirror[:, None] * right)
    return Transform(turn, middle_target - turn @ middle_model)
