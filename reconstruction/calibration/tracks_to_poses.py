"""Turns tracks into cameras: triangulates from the nominal rig, then adjusts and holds less and less.

From a nominal rig, a redescending loss falls into wrong minima at once, and so does a free focal length.
Letters: T tracks, V views.
"""

from dataclasses import replace

import numpy as np

from reconstruction.calibration.adjustment import Solution, adjust
from reconstruction.calibration.matches import Tracks
from reconstruction.calibration.problem import Freedom, Loss, Observations, Problem, ScenePoints, State
from reconstruction.calibration.projection import Cameras
from rigs.transform import Floats

FEATURE_SD_PX, PATCH_SD_PX = 0.3, 0.1
HELD_M = 1e-4
ROUGHLY = 1e-3  # gain at which a step on the way is good enough
FOCAL_SD = 0.02  # prior deviation of a nominal focal length, as a share
CENTER_SD_M = 0.02  # prior deviation of a nominal camera centre
STEPS = ((10.0, 1e-3), (5.0, 4e-3), (3.0, CENTER_SD_M), (1.0, CENTER_SD_M))  # Cauchy's bend in px, centre prior in m


def coarse(cameras: Cameras, tracks: Tracks) -> Solution:
    """Find the turns, with centres and focal length all but held: enough to judge matches by."""
    freedom = Freedom.poses(len(cameras), HELD_M)
    state = State(cameras, ScenePoints(triangulated(cameras, tracks)), np.zeros(len(freedom.prior_sd)))
    problem = Problem(observed(tracks, FEATURE_SD_PX), freedom, Loss("huber", 3.0 / FEATURE_SD_PX))
    return Solution(problem, adjust(problem, state, least_gain=ROUGHLY))


def annealed(start: Solution, tracks: Tracks) -> Solution:
    """Adjust from a coarse solution to free poses, then to a free focal length."""
    cameras = start.state.cameras
    observations = observed(tracks, FEATURE_SD_PX)
    state = State(cameras, ScenePoints(triangulated(cameras, tracks)), start.state.steps)
    for px, center_m in STEPS:
        freedom = Freedom.poses(len(cameras), center_m)
        state = adjust(Problem(observations, freedom, Loss("cauchy", px / FEATURE_SD_PX)), state, least_gain=ROUGHLY)
    return with_focal(state, observations, Loss("cauchy", STEPS[-1][0] / FEATURE_SD_PX))


def with_focal(state: State, observations: Observations, loss: Loss) -> Solution:
    """Adjust on with the focal length free, and with other observations of the same points."""
    freedom = Freedom.poses(len(state.cameras), CENTER_SD_M).shared_focal(state.cameras, FOCAL_SD)
    steps = np.append(state.steps, np.zeros(len(freedom.prior_sd) - len(state.steps)))
    problem = Problem(observations, freedom, loss)
    return Solution(problem, adjust(problem, replace(state, steps=steps), 40))


def observed(tracks: Tracks, sd_px: float) -> Observations:
    """Return every place of every track as an observation."""
    track, view = np.nonzero(tracks.seen)
    return Observations(view, track, tracks.places[track, view], np.full(len(track), sd_px))


def triangulated(cameras: Cameras, tracks: Tracks) -> Floats:
    """Return the points [T, 3] in m nearest to all rays of their tracks; distortion is left to the adjustment."""
    track, view = np.nonzero(tracks.seen)
    fx, fy, cx, cy = cameras.lenses[view, :4].T
    x, y = tracks.places[track, view].T
    rays = np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x)], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays = (rays[:, None] @ cameras.rotations[view])[:, 0]
    across = np.eye(3) - rays[:, :, None] * rays[:, None]
    normal, right = np.zeros((len(tracks), 3, 3)), np.zeros((len(tracks), 3))
    np.add.at(normal, track, across)
    np.add.at(right, track, (across @ cameras.centers[view][:, :, None])[:, :, 0])
    return np.asarray(np.linalg.solve(normal + 1e-9 * np.eye(3), right[:, :, None])[:, :, 0], dtype=np.float64)
