"""Readable twins of the native kernels that find points: plane sweep, confirmation, clusters, soft matches.

Letters: H rows, W columns, D inverse depths; n points of a target, m of a model. Costs of the sweep are whole steps, as
in the kernel.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from reconstruction.initialization.registration import ALIKE, MOST_UNLIKE, Cloud, Matches
from reconstruction.initialization.sweep import DepthMap, Image, SweepOptions, back_project, plane_induced
from rigs.camera import Camera
from rigs.transform import Transform

NO_PATH = 30000


def sweep_view_reference(
    reference: tuple[Camera, Image], sources: Sequence[tuple[Camera, Image]], options: SweepOptions
) -> DepthMap:
    """Readable twin of `sweep_view`."""
    nothing = np.zeros(reference[1].shape, np.float32)
    return _swept_reference(reference, sources, options, nothing, options.inverse_depths)


def sweep_around_reference(
    reference: tuple[Camera, Image],
    sources: Sequence[tuple[Camera, Image]],
    options: SweepOptions,
    around: Image,
    steps: NDArray[np.float64],
) -> DepthMap:
    """Readable twin of `sweep_around`."""
    inside = np.clip(around, options.inverse_depths[0] - steps[0], options.inverse_depths[-1] - steps[-1])
    return _swept_reference(reference, sources, options, inside.astype(np.float32), steps)


def _swept_reference(
    reference: tuple[Camera, Image],
    sources: Sequence[tuple[Camera, Image]],
    options: SweepOptions,
    around: Image,
    w: NDArray[np.float64],
) -> DepthMap:
    scale = np.float32(15000 / (1 + options.penalty_jump))
    one = int(scale)
    cost = np.stack([_matched(reference, sources, around + own, options) for own in w], axis=-1)  # [H, W, D]
    steps = (cost * one + 0.5).astype(np.int64)
    penalties = [int(p * scale + 0.5) for p in (options.penalty_step, options.penalty_jump)]
    paths = [_path(steps, axis, backward, *penalties) for axis in (0, 1) for backward in (False, True)]
    total = np.sum(paths, axis=0)
    best = total.argmin(axis=-1)
    inner = np.clip(best, 1, len(w) - 2)
    below, here, above = (np.take_along_axis(total, (inner + k)[..., None], -1)[..., 0] for k in (-1, 0, 1))
    bend = below - 2 * here + above
    offset = np.clip(0.5 * (below - above) / np.maximum(bend, 1), -0.5, 0.5) * ((bend > 0) & (inner == best))
    depth = 1 / (around + w[best] + offset * (w[1] - w[0]))
    found = np.take_along_axis(steps, best[..., None], -1)[..., 0] / one
    return DepthMap(reference[0], depth.astype(np.float32), found.astype(np.float32))


def _matched(
    reference: tuple[Camera, Image],
    sources: Sequence[tuple[Camera, Image]],
    inverse_depth: NDArray[np.floating],
    options: SweepOptions,
) -> NDArray[np.float64]:
    """Mean of the two best costs [H, W] at one hypothesis: an inverse depth [H, W] of every pixel."""
    camera, image = reference
    r, floor = options.radius_px, options.noise**2
    area = _windows(np.ones(image.shape), r)
    mean = _windows(image, r) / area
    spread = np.sqrt(np.maximum(_windows(image.astype(np.float64) ** 2, r) / area - mean**2, 0) + floor)
    costs = [np.ones(image.shape)] * 2
    for source, source_image in sources:
        warped, seen = _warped(camera, source, source_image, inverse_depth)
        warped_mean = _windows(warped, r) / area
        variance = np.maximum(_windows(warped**2, r) / area - warped_mean**2, 0)
        covariance = _windows(warped * image, r) / area - warped_mean * mean
        costs.append(np.where(seen, np.minimum(1 - covariance / spread / np.sqrt(variance + floor), 1), 1))
    return np.sort(costs, axis=0)[:2].mean(axis=0)


def _windows(image: NDArray, radius: int) -> NDArray[np.float64]:
    """Sums over squares of 2 radius + 1, clipped at the border."""
    padded = np.pad(image.astype(np.float64), radius)
    return np.lib.stride_tricks.sliding_window_view(padded, (2 * radius + 1,) * 2).sum(axis=(-2, -1))


def _warped(
    camera: Camera, source: Camera, image: Image, inverse_depth: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The source as the reference sees it by its inverse depths, bilinear, and where it sees anything."""
    homography, epipole = plane_induced(camera, source)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    at = np.stack([x, y, np.ones_like(x)], axis=-1) @ homography.reshape(3, 3).T + epipole * inverse_depth[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = (at[..., i] / at[..., 2] - 0.5 for i in (0, 1))
        seen = (at[..., 2] > 1e-6) & (u >= 0) & (v >= 0) & (u < source.width - 1) & (v < source.height - 1)
    u, v = np.where(seen, u, 0), np.where(seen, v, 0)
    column, row = u.astype(int), v.astype(int)
    padded = np.pad(image.astype(np.float64), ((0, 1), (0, 1)))
    above = padded[row, column] * (1 - u + column) + padded[row, column + 1] * (u - column)
    below = padded[row + 1, column] * (1 - u + column) + padded[row + 1, column + 1] * (u - column)
    return np.where(seen, above * (1 - v + row) + below * (v - row), 0), seen


def _path(cost: NDArray[np.int64], axis: int, backward: bool, step: int, jump: int) -> NDArray[np.int64]:
    """Semi-global costs [H, W, D] along one direction."""
    lines = np.moveaxis(cost, axis, 0)[:: -1 if backward else 1]
    out = np.empty_like(lines)
    before = np.zeros_like(lines[0])
    for i, here in enumerate(lines):
        edges = np.full_like(before[:, :1], NO_PATH if i else 0)
        below, above = np.hstack([edges, before[:, :-1]]), np.hstack([before[:, 1:], edges])
        lowest = before.min(axis=1, keepdims=True)
        before = here + np.minimum(np.minimum(before, lowest + jump), np.minimum(below, above) + step) - lowest
        out[i] = before
    return np.moveaxis(out[:: -1 if backward else 1], 0, axis)


def confirmations_reference(reference: DepthMap, others: Sequence[DepthMap], tolerance: float) -> NDArray[np.uint8]:
    """Readable twin of `confirmations`."""
    votes = np.zeros(reference.depth.shape, np.uint8)
    points = back_project(reference.camera, reference.depth)
    for other in others:
        camera = other.camera
        in_other = camera.cam_from_rig.apply(points)
        z = np.where(in_other[..., 2] > 1e-6, in_other[..., 2], np.nan)
        u, v = in_other[..., 0] / z * camera.fx + camera.cx, in_other[..., 1] / z * camera.fy + camera.cy
        height, width = other.depth.shape
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        row, column = (np.floor(np.where(inside, a, 0)).astype(np.int64) for a in (v, u))
        with np.errstate(divide="ignore"):
            votes += inside & (np.abs(1 / other.depth[row, column].astype(np.float64) - 1 / z) <= tolerance)
    return votes


def linked_reference(positions: NDArray[np.float64], gap_m: float) -> NDArray[np.int64]:
    """Readable twin of `linked`."""
    near = ((positions[:, None] - positions) ** 2).sum(axis=-1) <= gap_m**2
    numbers = np.arange(len(positions))
    for _ in positions:  # everything takes the first of what it is joined to
        numbers = np.where(near, numbers, len(positions)).min(axis=1, initial=len(positions))
    return np.unique(numbers, return_inverse=True)[1]


def soft_matches_reference(model: Cloud, target: Cloud, pose: Transform, width: float, stray: float) -> Matches:
    """Readable twin of `soft_matches`."""
    (at, light), (target_at, target_light) = ((a.astype(np.float64), b.astype(np.float64)) for a, b in (model, target))
    squared = ((target_at[:, None] - pose.apply(at)) ** 2).sum(axis=-1)
    unlike = (target_light[:, None] - light) ** 2 / (2 * ALIKE**2)
    weight = np.exp(-np.minimum(squared / (2 * width**2) + unlike, MOST_UNLIKE))
    return matches_of(at, target_at, weight / (weight.sum(axis=1, keepdims=True) + stray), squared)


def matches_of(model: NDArray, target: NDArray, match: NDArray, squared: NDArray) -> Matches:
    """Return the sums of matches [n, m] at squared distances [n, m] between points [m, 3] and [n, 3]."""
    by_model, by_target = match.sum(axis=0) @ model, match.sum(axis=1) @ target
    return Matches(float(match.sum()), float((match * squared).sum()), by_model, by_target, target.T @ match @ model)
