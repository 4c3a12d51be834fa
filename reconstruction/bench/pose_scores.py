"""Scores the depth and points of estimated cameras against the truth, in the true frame."""

import numpy as np
from numpy.typing import NDArray

from reconstruction.bench.conventions import KnownRecording
from reconstruction.initialization.geometry import Geometry
from reconstruction.initialization.sweep import SweepOptions, depth_range_m
from reconstruction.pipeline.points_stage import swept_maps
from rigs.rig import Rig
from rigs.similarity import align

CLOSE = 0.01  # relative error up to which a depth counts as complete
MOST_POINTS = 20000  # points of a method's own that are scored
WRONG = 0.5  # relative error at most, of a point behind a camera, say


def score_sweep(found: Rig, clip: KnownRecording) -> dict[str, float]:
    """Return `abs_rel` of the confirmed depths of a plane sweep on long-window images, and `complete`.

    `complete` is the share of the still pixels whose depth is within CLOSE of the truth.
    """
    cameras = list(align(found, clip.rig).carry_rig(found).cameras)
    images = [clip.long_images[c.id] for c in cameras]
    maps = swept_maps(cameras, images, SweepOptions(*depth_range_m(clip.rig.cameras)))
    off, pixels = [], 0
    for camera, swept in zip(cameras, maps, strict=True):
        depth, still = _truth(clip, camera.id)
        seen = still & np.isfinite(swept.depth)
        off.append(np.abs(swept.depth - depth)[seen] / depth[seen])
        pixels += int(still.sum())
    errors = np.concatenate(off)
    if not len(errors):
        return {"complete": 0.0}
    return {"abs_rel": float(errors.mean()), "complete": float((errors < CLOSE).sum() / pixels)}


def score_own_points(found: Geometry, clip: KnownRecording) -> dict[str, float]:
    """Return `points`, a method's number of points, and `points_abs_rel`: each in its best view, on still pixels."""
    if not len(found.points):
        return {}
    rng = np.random.default_rng(0)
    chosen = rng.permutation(len(found.points))[:MOST_POINTS]
    points = align(found.rig, clip.rig).apply(found.points[chosen])
    best = np.full(len(points), np.inf)
    for camera in clip.rig.cameras:
        depth, still = _truth(clip, camera.id)
        pixels, seen = camera.project(points)
        where = np.flatnonzero(seen)
        column, row = pixels[where].astype(np.int64).T
        z, true = camera.cam_from_rig.apply(points[where])[:, 2], depth[row, column]
        error = np.where(still[row, column], np.abs(z - true) / true, np.inf)
        best[where] = np.minimum(best[where], error)
    known = np.isfinite(best)
    if not known.any():
        return {"points": float(len(found.points))}
    return {"points": float(len(found.points)), "points_abs_rel": float(np.minimum(best[known], WRONG).mean())}


def _truth(clip: KnownRecording, camera_id: str) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the true depth [H, W] in m at the middle of the clip, and where it is known and nothing moves."""
    planes = clip.truth.planes(camera_id)
    frame = clip.truth.frame(camera_id, planes[len(planes) // 2])
    return frame.depth, ~frame.moving & np.isfinite(frame.depth)
