"""Matches features of pairs of views, gates them by the nominal rig, verifies them, and joins them to tracks.

The gates come before the verification. On repeated texture a fundamental matrix verifies many matches that agree with
one another and are wrong. Between the cameras of one row they lie on the epipolar line, where only the depth tells.
Letters: V views, M matches of a pair, T tracks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.calibration.features import Features
from rigs.camera import Camera
from rigs.transform import Floats, cross_matrices

RATIO = 0.8
VERIFIED_PX = 1.0
LEAST_MATCHES = 12  # fewest matches of a pair that is verified
Pair = tuple[int, int]
Matches = NDArray[np.int64]


@dataclass(frozen=True)
class Gate:
    """The limits of a nominal rig on matches: px from the epipolar line, and depths in distances to the object."""

    epipolar_px: float
    nearest: float = 0.35
    farthest: float = 8.0
    along: float = 0.6  # of `epipolar_px`, by which a match may lie beyond the depths


def matched(one: Features, other: Features) -> Matches:
    """Return the indices [M, 2] of features that are each other's nearest, by Lowe's ratio in both directions."""
    if len(one) < 2 or len(other) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    alike = one.descriptors @ other.descriptors.T
    back = _clear(np.ascontiguousarray(alike.T))
    forth = _clear(alike)
    mine = np.flatnonzero(forth >= 0)
    mutual = mine[back[forth[mine]] == mine]
    return np.stack([mutual, forth[mutual]], axis=1)


def _clear(alike: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return each row's best column of cosines [N, M], -1 where the second best is as good. `alike` is changed."""
    rows = np.arange(len(alike))
    best = alike.argmax(axis=1)
    first = alike[rows, best]
    alike[rows, best] = -1.0
    near, next_near = (np.sqrt(np.maximum(2 - 2 * cosine, 0)) for cosine in (first, alike.max(axis=1)))
    return np.where(near < RATIO * next_near, best, -1)


def gated(places: tuple[Floats, Floats], cameras: tuple[Camera, Camera], gate: Gate, distance_m: float) -> NDArray:
    """Return which of M matched places ([M, 2], [M, 2] in px) the nominal cameras allow."""
    rays = [np.insert(c.slopes(p), 2, 1.0, axis=1) for p, c in zip(places, cameras, strict=True)]
    one, other = cameras
    base = other.cam_from_rig @ one.cam_from_rig.inverse()
    lines = rays[0] @ (cross_matrices(base.translation) @ base.rotation).T  # epipolar lines in the other image
    off = np.abs((lines * rays[1]).sum(axis=1)) / np.maximum(np.linalg.norm(lines[:, :2], axis=1), 1e-12)
    depths = _depths(rays, base.rotation, base.translation)
    slack = (
        gate.along * gate.epipolar_px / (one.fx * max(float(np.linalg.norm(base.translation)), 1e-9))
    )  # of 1 / depth, in 1 / m
    inverse = np.stack([1 / np.where(np.abs(d) < 1e-9, 1e-9, d) for d in depths])
    low, high = 1 / (gate.farthest * distance_m) - slack, 1 / (gate.nearest * distance_m) + slack
    return (off * other.fx < gate.epipolar_px) & ((inverse > low) & (inverse < high)).all(axis=0)


def _depths(rays: Sequence[Floats], rotation: Floats, translation: Floats) -> tuple[Floats, Floats]:
    """Return the depths [M] in m, along z of either camera, of the points nearest to both rays."""
    a, b = rays[0] @ rotation.T, rays[1]
    aa, ab, bb = (a * a).sum(axis=1), (a * b).sum(axis=1), (b * b).sum(axis=1)
    at, bt = a @ translation, b @ translation
    det = aa * bb - ab**2
    det = np.where(det < 1e-12, 1e-12, det)
    return (ab * bt - bb * at) / det, (aa * bt - ab * at) / det


def verified(places: tuple[Floats, Floats], seed: int) -> NDArray[np.bool_]:
    """Return which matches [M] one fundamental matrix explains (MAGSAC, Barath et al., CVPR 2019)."""
    if len(places[0]) < LEAST_MATCHES:
        return np.zeros(len(places[0]), dtype=np.bool_)
    cv2.setRNGSeed(seed)
    one, other = (np.ascontiguousarray(p) for p in places)
    try:
        _, inliers = cv2.findFundamentalMat(one, other, cv2.USAC_MAGSAC, VERIFIED_PX, 0.999, 5000)
    except cv2.error:  # it asserts where no sample gave a model
        inliers = None
    return np.zeros(len(places[0]), np.bool_) if inliers is None else inliers.ravel().astype(np.bool_)


@dataclass(frozen=True, eq=False)
class Tracks:
    """T tracks: `seen` [T, V] is whether a view sees one, `places` [T, V, 2] in px where (NaN where it does not)."""

    places: Floats

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Return whether each view sees each track [T, V]."""
        return np.isfinite(self.places[:, :, 0])

    @classmethod
    def of(cls, parts: Sequence[Tracks]) -> Tracks:
        """Return the tracks of all parts, one after another."""
        return cls(np.concatenate([part.places for part in parts]))

    def __len__(self) -> int:
        return len(self.places)

    def only(self, kept: NDArray) -> Tracks:
        """Return the tracks at indices, or where a mask is true."""
        return Tracks(self.places[kept])


def joined(features: Sequence[Features], matches: Mapping[Pair, Matches], least_views: int) -> Tracks:
    """Join the matches of all pairs to tracks; one with two places in a view, or in too few views, is dropped."""
    first = np.cumsum([0, *map(len, features)])
    parent = np.arange(first[-1])

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = int(parent[i])
        return i

    links = [np.zeros((0, 2), np.int64), *(pairs + first[list(views)] for views, pairs in matches.items())]
    for i, j in np.concatenate(links):
        parent[root(int(i))] = root(int(j))
    linked = np.unique(np.concatenate(links))
    roots = np.array([root(int(i)) for i in linked], dtype=np.int64)
    view = np.searchsorted(first, linked, side="right") - 1
    _, track = np.unique(roots, return_inverse=True)
    count = np.zeros((int(track.max(initial=-1)) + 1, len(features)), dtype=np.int64)
    np.add.at(count, (track, view), 1)
    places = np.full((*count.shape, 2), np.nan)
    places[track, view] = np.concatenate([f.places for f in features])[linked] if len(linked) else places[track, view]
    return Tracks(places[(count.max(axis=1, initial=0) == 1) & ((count > 0).sum(axis=1) >= least_views)])
