"""Soft matches between two samples of points, as the sums that a rigid fit needs.

Letters: n points of the target, m of the model. Every target point is matched with all model points by distance and by
brightness, or with none. Source: Myronenko & Song, "Point set registration: coherent point drift", PAMI 2010; Umeyama,
PAMI 1991 (the fit).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.native import Address
from reconstruction.native import Double, Int, kernel
from rigs.transform import Transform

MOST_UNLIKE = 40.0  # exponent beyond which a match is none
ALIKE = 0.04  # spikes per tick: brightness of one surface point seen at two instants
_POINTS = (Address, Address, Int)
_soft_matches = kernel("soft_matches", *_POINTS, *_POINTS, Address, *[Double] * 4, Address)

Cloud = tuple[NDArray[np.float32], NDArray[np.float32]]  # positions [n, 3] in m, intensities [n] in spikes per tick


@dataclass(frozen=True, eq=False)
class Matches:
    """Sums over all pairs of a match between 0 and 1, and what it multiplies."""

    total: float
    squared: float  # m^2, of the distances
    model: NDArray[np.float64]  # [3] m
    target: NDArray[np.float64]  # [3] m
    cross: NDArray[np.float64]  # [3, 3] m^2, target by model

    @classmethod
    def of(cls, model: NDArray, target: NDArray, match: NDArray, squared: NDArray) -> Matches:
        """The sums of matches [n, m] at squared distances [n, m] between points [m, 3] and [n, 3]."""
        by_model, by_target = match.sum(axis=0) @ model, match.sum(axis=1) @ target
        return cls(float(match.sum()), float((match * squared).sum()), by_model, by_target, target.T @ match @ model)


def soft_matches(model: Cloud, target: Cloud, pose: Transform, width: float, stray: float) -> Matches:
    """The matches where `pose` carries the model to the target, `width` metres wide; `stray` weighs having none."""
    points = [np.ascontiguousarray(a, dtype=np.float32) for a in (*model, *target)]
    numbers = np.concatenate([pose.rotation.ravel(), pose.translation]).astype(np.float64)
    sums = np.empty(17)
    sizes = (len(points[0]), len(points[2]))
    _soft_matches(*points[:2], sizes[0], *points[2:], sizes[1], numbers, width, ALIKE, MOST_UNLIKE, stray, sums)
    return Matches(float(sums[0]), float(sums[1]), sums[2:5], sums[5:8], sums[8:].reshape(3, 3))


def soft_matches_reference(model: Cloud, target: Cloud, pose: Transform, width: float, stray: float) -> Matches:
    """Readable twin of `soft_matches`."""
    (at, light), (target_at, target_light) = ((a.astype(np.float64), b.astype(np.float64)) for a, b in (model, target))
    squared = ((target_at[:, None] - pose.apply(at)) ** 2).sum(axis=-1)
    unlike = (target_light[:, None] - light) ** 2 / (2 * ALIKE**2)
    weight = np.exp(-np.minimum(squared / (2 * width**2) + unlike, MOST_UNLIKE))
    return Matches.of(at, target_at, weight / (weight.sum(axis=1, keepdims=True) + stray), squared)


def rigid_fit(matches: Matches) -> Transform:
    """The pose that brings the model nearest to the target in the squares weighted by the matches."""
    middle_model, middle_target = matches.model / matches.total, matches.target / matches.total
    left, _, right = np.linalg.svd(matches.cross - np.outer(middle_target, matches.model))
    mirror = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    turn = left @ (mirror[:, None] * right)
    return Transform(turn, middle_target - turn @ middle_model)
