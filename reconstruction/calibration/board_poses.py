"""Where a board was at each instant, as a start: from one camera's picture of it, judged by all cameras.

A picture of a plane allows two poses (Collins and Bartoli, "Infinitesimal plane-based pose estimation", IJCV 2014); the
other cameras tell which, and which camera's pose is the best.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from reconstruction.calibration.board_sightings import Sightings
from reconstruction.calibration.problem import BoardPoses
from reconstruction.calibration.projection import Cameras, project
from rigs.camera import Camera
from rigs.transform import Floats, Transform

LEAST_POINTS = 4
LEAST_WIDTH = 0.1  # of the points' extent across their length; less is a line
MOST_PX = 50.0  # what a point far off counts at most


def starting_poses(points: Floats, sightings: Sightings, cameras: Sequence[Camera]) -> list[Transform | None]:
    """`rig_from_board` of every pose, by the cameras as drawn; None where no picture of it tells."""
    return [_best(points, sightings, cameras, sightings.pose == pose) for pose in range(sightings.poses)]


def _best(points: Floats, sightings: Sightings, cameras: Sequence[Camera], these: np.ndarray) -> Transform | None:
    corners, pixels, which = points[sightings.point[these]], sightings.pixels[these], sightings.camera[these]
    best, least = None, np.inf
    for number in np.unique(which):
        own = which == number
        for pose in _from_one(corners[own], pixels[own], cameras[number]):
            seen = project(pose.apply(corners), Cameras.of(cameras), which)
            off = np.linalg.norm(np.where(seen.seen[:, None], seen.pixels - pixels, MOST_PX), axis=1)
            cost = float(np.minimum(off, MOST_PX).sum())
            if cost < least:
                best, least = pose, cost
    return best


def _from_one(corners: Floats, pixels: Floats, camera: Camera) -> list[Transform]:
    """The poses of the board in the rig that one camera's picture allows."""
    spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
    if len(corners) < LEAST_POINTS or spread[1] < LEAST_WIDTH * spread[0]:
        return []
    lens = np.array(camera.distortion)
    found = cv2.solvePnPGeneric(corners, pixels[:, None].copy(), camera.K, lens, flags=cv2.SOLVEPNP_IPPE)
    rig_from_cam = camera.cam_from_rig.inverse()
    poses = []
    for turn, shift in zip(found[1], found[2], strict=True):
        if np.isfinite(turn).all() and np.isfinite(shift).all() and shift.ravel()[2] > 0:
            poses.append(rig_from_cam @ Transform.from_rotvec(turn.ravel(), shift.ravel()))
    return poses


def board_poses(poses: Sequence[Transform], corners: Floats) -> BoardPoses:
    """The poses as what an adjustment eliminates; `corners` [O, 3] as its observations are."""
    return BoardPoses(np.array([p.rotation for p in poses]), np.array([p.translation for p in poses]), corners)
