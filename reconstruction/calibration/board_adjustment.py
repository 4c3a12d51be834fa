"""Cameras from sightings of a board: poses, then lenses, then only those parts of the lenses that the sightings show.

Poses and one focal factor of all cameras are always free. Each camera's own focal length, its principal point, k1 and
k2 are freed together. Then groups that are not significant go back to their nominal values, the least significant
first: a group of n values stays while its Wald statistic is above n log(observed numbers), the price of a parameter in
Schwarz, "Estimating the dimension of a model", 1978. Other values would only make the poses worse. k3, where k2 stayed,
and then p1 and p2 together, which look almost like a principal point, are freed afterwards and judged alike, with all
others once more; a fisheye keeps its own.

Each pose of the board begins as one picture has it. A picture of a plane allows two poses (Collins and Bartoli,
"Infinitesimal plane-based pose estimation", IJCV 2014); the other cameras tell which, and whose pose is the best.

The nominal rig is a weak prior that holds what the board does not determine, and says where the rig lies.
Letters: C cameras, G free values, L poses of the board, O observations.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from reconstruction.calibration.adjustment import Solution, adjust, linearised
from reconstruction.calibration.board_sightings import Sightings
from reconstruction.calibration.problem import BoardPoses, Freedom, Loss, Observations, Problem, State
from reconstruction.calibration.projection import Cameras, project
from reconstruction.errors import GeometryError
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Floats, Transform

TURN_SD, CENTER_SD_M, FOCAL_SD = np.radians(3.0), 0.03, 0.03  # prior of a nominal rig: rad, m, share of the length
OWN_FOCAL_SD = 0.01  # prior deviation between lenses of one kind, as a share
PRINCIPAL_SD = 0.01  # prior deviation, as a share of the picture's width
DISTORTION_SD = 0.3
ROUGH_PX, FINE_PX = 1.0, 0.05  # standard deviations of a point, at first and later
LEAST_PX = 0.001  # least standard deviation of a point
LEAST_POINTS = 4  # fewest points of a board in a picture that tells its pose
LEAST_WIDTH = 0.1  # least extent of the points across their length, as a share of it; less is a line
MOST_PX = 50.0  # largest distance that a point far off counts with
BEND = 4.0  # Huber's, in standard deviations
OWN, PRINCIPAL, K1, K2, K3, TANGENTIAL = LENS_GROUPS = (
    "own focal lengths",
    "principal points",
    "k1",
    "k2",
    "k3",
    "p1 p2",
)
RARE_SDS = {K3: 3.0, TANGENTIAL: 0.03}  # prior deviations, of values in a lens that is well made
HIGHER = {K1: K2, K2: K3}  # groups that are judged once the other is gone


@dataclass(frozen=True, eq=False)
class BoardSolution(Solution):
    """Cameras from a board: the standard deviation of an observation, and which parts of the lenses were found.

    `covariance` [G, G] of the free values counts only poses that differ: those nearly alike err alike. `found` are the
    groups of LENS_GROUPS that were significant.
    """

    sd_px: float
    covariance: Floats
    found: tuple[str, ...]


def solve(rig: Rig, points: Floats, sightings: Sightings) -> tuple[BoardSolution, Sightings]:
    """Find the cameras of `rig` by `sightings` of a board with `points` [N, 3] in m; return the sightings used, too.

    Raises GeometryError where no picture tells how the board stood.
    """
    poses = [_best(points, sightings, rig.cameras, pose) for pose in range(sightings.poses)]
    sightings = sightings.only(np.array([pose is not None for pose in poses]))
    if not len(sightings):
        raise GeometryError("found no picture with four points of the board that are not in a line", do="show it whole")
    stood = [pose for pose in poses if pose is not None]
    turns, shifts = np.array([pose.rotation for pose in stood]), np.array([pose.translation for pose in stood])
    blocks = BoardPoses(turns, shifts, points[sightings.point])
    freedom = _whole_freedom(rig)
    first = freedom.only(freedom.of("poses"))
    state = State(Cameras.of(rig.cameras), blocks, np.zeros(len(first.prior_sd)))
    state = adjust(_problem(sightings, first, ROUGH_PX, 10.0), state)
    state = replace(state, steps=np.append(state.steps, np.zeros(len(freedom.prior_sd) - len(state.steps))))
    state = adjust(_problem(sightings, freedom, FINE_PX), state, 60)
    return _grown(_reduced(freedom, sightings, state), sightings), sightings


def _grown(solution: BoardSolution, sightings: Sightings) -> BoardSolution:
    """Return the solution with k3, and with p1 and p2, where they are significant beside all else; else as it was."""
    for group, prior_sd in RARE_SDS.items():
        if solution.state.cameras.fisheye.any() or (group == K3 and K2 not in solution.found):
            continue
        freedom = solution.problem.freedom.each(group.split(), prior_sd, group)
        steps = np.append(solution.state.steps, np.zeros(len(freedom.prior_sd) - len(solution.state.steps)))
        larger = _reduced(freedom, sightings, replace(solution.state, steps=steps))
        solution = larger if group in larger.found else solution
    return solution


def _reduced(freedom: Freedom, sightings: Sightings, state: State) -> BoardSolution:
    """Return the solution in which every group that is not significant has its nominal values."""
    while True:
        problem = _problem(sightings, freedom, noise_px(_problem(sightings, freedom, FINE_PX), state))
        state = adjust(problem, state, least_gain=1e-9)
        sd_px = noise_px(problem, state)
        problem = _problem(sightings, freedom, sd_px)
        covariance = plain_covariance(problem, state)
        weakest = _weakest(freedom, state.steps, covariance, 2 * len(sightings))
        if weakest is None:
            covariance = covariance * sightings.poses / sightings.distinct()
            return BoardSolution(
                problem, state, sd_px, covariance, tuple(g for g in LENS_GROUPS if g in freedom.groups)
            )
        own = freedom.of(weakest)
        back = -freedom.mixing[:, :, own] @ state.steps[own]
        state = State(state.cameras.moved(back), state.blocks, np.delete(state.steps, own))
        freedom = freedom.only(np.delete(np.arange(len(freedom.prior_sd)), own))


def _weakest(freedom: Freedom, steps: Floats, covariance: Floats, numbers: int) -> str | None:
    """Return the least significant group, if it is not significant; k1 is judged once k2 is gone, that once k3 is."""
    ratios = {}
    for group in LENS_GROUPS:
        if group in freedom.groups and HIGHER.get(group) not in freedom.groups:
            own = freedom.of(group)
            x = steps[own]
            ratios[group] = float(x @ np.linalg.solve(covariance[np.ix_(own, own)], x)) / (len(x) * np.log(numbers))
    weakest = min(ratios, key=ratios.__getitem__, default=None)
    return weakest if weakest is not None and ratios[weakest] < 1 else None


def _whole_freedom(rig: Rig) -> Freedom:
    """Return the freedom of all values that may be found, by group."""
    cameras, width = Cameras.of(rig.cameras), max(camera.width for camera in rig.cameras)
    freedom = Freedom.poses(len(cameras), CENTER_SD_M, TURN_SD).shared_focal(cameras, FOCAL_SD)
    freedom = freedom.own_focal(cameras, OWN_FOCAL_SD, OWN).each(("cx", "cy"), PRINCIPAL_SD * width, PRINCIPAL)
    return freedom.each((K1,), DISTORTION_SD, K1).each((K2,), DISTORTION_SD, K2)


def _problem(sightings: Sightings, freedom: Freedom, sd_px: float, bend: float = BEND) -> Problem:
    sds = np.full(len(sightings), sd_px)
    observations = Observations(sightings.camera, sightings.pose, sightings.pixels, sds)
    return Problem(observations, freedom, Loss("huber", bend))


def noise_px(problem: Problem, state: State) -> float:
    """Return the standard deviation of a point's x or y, from the middle residual and the number of free values."""
    residuals = linearised(problem, state).residuals
    numbers, free = residuals.size, len(state.steps) + 6 * len(state.blocks)
    spread = 1.4826 * float(np.median(np.abs(residuals)))
    return max(spread * float(np.sqrt(numbers / max(numbers - free, 0.1 * numbers))), LEAST_PX)


def plain_covariance(problem: Problem, state: State) -> Floats:
    """Return the covariance [G, G] of the free values, with priors, for residuals that err independently by `sd_px`."""
    at = linearised(problem, state)
    folded = at.coupling @ np.linalg.inv(at.block_hessian)
    return np.asarray(np.linalg.inv(at.hessian - np.einsum("lgd,lhd->gh", folded, at.coupling, optimize=True)))


def _best(points: Floats, sightings: Sightings, cameras: Sequence[Camera], number: int) -> Transform | None:
    """Return `rig_from_board` for pose `number` of the board, by the cameras as drawn; None where no picture tells."""
    these = sightings.pose == number
    corners, pixels, which = points[sightings.point[these]], sightings.pixels[these], sightings.camera[these]
    best, least = None, np.inf
    for camera in np.unique(which):
        own = which == camera
        for pose in _from_one(corners[own], pixels[own], cameras[camera]):
            seen = project(pose.apply(corners), Cameras.of(cameras), which)
            off = np.linalg.norm(np.where(seen.seen[:, None], seen.pixels - pixels, MOST_PX), axis=1)
            cost = float(np.minimum(off, MOST_PX).sum())
            if cost < least:
                best, least = pose, cost
    return best


def _from_one(corners: Floats, pixels: Floats, camera: Camera) -> list[Transform]:
    """Return the poses of the board in the rig that one camera's picture allows."""
    spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
    if len(corners) < LEAST_POINTS or spread[1] < LEAST_WIDTH * spread[0]:
        return []
    slopes = camera.slopes(pixels)
    if not np.isfinite(slopes).all():
        return []
    found = cv2.solvePnPGeneric(corners, slopes[:, None].copy(), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    rig_from_cam = camera.cam_from_rig.inverse()
    poses = []
    for turn, shift in zip(found[1], found[2], strict=True):
        if np.isfinite(turn).all() and np.isfinite(shift).all() and shift.ravel()[2] > 0:
            poses.append(rig_from_cam @ Transform.from_rotvec(turn.ravel(), shift.ravel()))
    return poses
