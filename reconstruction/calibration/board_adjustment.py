"""Cameras from sightings of a board: poses, then lenses, then only as much of the lenses as the sightings call for.

Poses and one focal factor of all cameras are always free. Each camera's own focal length, its principal point, k1 and
k2 are freed together, and what is not significant goes back to its nominal value, the least significant first: a group
of n values stays while its Wald statistic is above n log(observed numbers), the price of a parameter in Schwarz,
"Estimating the dimension of a model", 1978. Values that do not show only make the poses worse. p1 and p2 stay as they
are: at these angles they are hardly to be told from a principal point.

The nominal rig is a weak prior that holds what the board does not determine, and says where the rig lies.
Letters: C cameras, G free values, L poses of the board, O observations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from reconstruction.calibration.adjustment import adjust, linearised
from reconstruction.calibration.board_poses import board_poses, starting_poses
from reconstruction.calibration.board_sightings import Sightings
from reconstruction.calibration.problem import Freedom, Loss, Observations, Problem, State
from reconstruction.calibration.projection import PARAMETERS, Cameras
from reconstruction.errors import GeometryError
from rigs.rig import Rig
from rigs.transform import Floats

TURN_SD, CENTER_SD_M, FOCAL_SD = np.radians(3.0), 0.03, 0.03  # of a nominal rig
OWN_FOCAL_SD = 0.01  # of lenses of one kind
PRINCIPAL_SD = 0.01  # of the picture's width
DISTORTION_SD = 0.3
ROUGH_PX, FINE_PX, LEAST_PX = (
    1.0,
    0.05,
    0.001,
)  # standard deviations of a point on the way; the last is never gone below
BEND = 4.0  # Huber's, in standard deviations
OWN, PRINCIPAL, K1, K2 = LENS_GROUPS = ("own focal lengths", "principal points", "k1", "k2")


@dataclass(frozen=True, eq=False)
class Solution:
    """Cameras, the problem they are the solution of, and the observations' noise.

    `covariance` [G, G] of the free values, for as many poses as are distinct: those nearly alike err alike. `found` are
    the groups of LENS_GROUPS that were significant.
    """

    problem: Problem
    state: State
    sd_px: float
    covariance: Floats
    found: tuple[str, ...]

    def residuals_px(self) -> Floats:
        """Residuals [O, 2] of the observations."""
        return linearised(self.problem, self.state).residuals


@dataclass(frozen=True, eq=False)
class _Values:
    """All values that can be free, and which of them [g] belong to each group."""

    freedom: Freedom
    groups: dict[str, NDArray[np.int64]]

    def only(self, groups: tuple[str, ...]) -> Freedom:
        """The freedom with these groups alone."""
        kept = self.places(groups)
        free = self.freedom
        return Freedom(free.mixing[:, :, kept], free.prior_sd[kept], free.prior_mean[kept])

    def places(self, groups: tuple[str, ...]) -> NDArray[np.int64]:
        """Where the groups' values are among all."""
        return np.concatenate([self.groups[name] for name in groups])


def solve(rig: Rig, points: Floats, sightings: Sightings) -> tuple[Solution, Sightings]:
    """The cameras of `rig` as `sightings` of a board with `points` [N, 3] have them, and the sightings that served.

    Raises GeometryError where no picture tells how the board stood.
    """
    poses = starting_poses(points, sightings, rig.cameras)
    sightings = sightings.only(np.array([pose is not None for pose in poses]))
    if not len(sightings):
        raise GeometryError("found no picture with four points of the board that are not in a line", do="show it whole")
    cameras, values = Cameras.of(rig.cameras), _all_values(rig)
    blocks = board_poses([pose for pose in poses if pose is not None], points[sightings.point])
    groups: tuple[str, ...] = ("poses",)
    state = State(cameras, blocks, np.zeros(len(values.places(groups))))
    state = adjust(_problem(sightings, values.only(groups), ROUGH_PX, 10.0), state)
    state = replace(state, steps=np.append(state.steps, np.zeros(len(values.freedom.prior_sd) - len(state.steps))))
    groups = ("poses", "focal", *LENS_GROUPS)
    state = adjust(_problem(sightings, values.only(groups), FINE_PX, BEND), state, 60)
    return _reduced(values, sightings, state, groups), sightings


def _reduced(values: _Values, sightings: Sightings, state: State, groups: tuple[str, ...]) -> Solution:
    """The solution with what is not significant at its nominal value."""
    while True:
        problem = _problem(sightings, values.only(groups), FINE_PX, BEND)
        problem = _problem(sightings, values.only(groups), noise_px(problem, state), BEND)
        state = adjust(problem, state, least_gain=1e-9)
        sd_px = noise_px(problem, state)
        problem = _problem(sightings, values.only(groups), sd_px, BEND)
        covariance = plain_covariance(problem, state)
        weakest = _weakest(values, groups, state.steps, covariance, 2 * len(sightings))
        if weakest is None:
            covariance = covariance * sightings.poses / sightings.distinct()
            return Solution(problem, state, sd_px, covariance, tuple(g for g in groups if g in LENS_GROUPS))
        state, groups = _without(weakest, values, groups, state)


def _weakest(values: _Values, groups: tuple[str, ...], steps: Floats, covariance: Floats, numbers: int) -> str | None:
    """The group that is significant least, if it is not at all; k1 is judged once k2 is gone."""
    judged = [g for g in groups if g in LENS_GROUPS and not (g == K1 and K2 in groups)]
    place = {g: _within(values, groups, g) for g in judged}
    ratios = {}
    for group in judged:
        own, x = place[group], steps[place[group]]
        ratios[group] = float(x @ np.linalg.solve(covariance[np.ix_(own, own)], x)) / (len(x) * np.log(numbers))
    weakest = min(ratios, key=ratios.__getitem__, default=None)
    return weakest if weakest is not None and ratios[weakest] < 1 else None


def _without(group: str, values: _Values, groups: tuple[str, ...], state: State) -> tuple[State, tuple[str, ...]]:
    """The state with a group's values back where they were, and the groups that remain."""
    own = _within(values, groups, group)
    back = -values.only(groups).mixing[:, :, own] @ state.steps[own]
    steps = np.delete(state.steps, own)
    return State(state.cameras.moved(back), state.blocks, steps), tuple(g for g in groups if g != group)


def _within(values: _Values, groups: tuple[str, ...], group: str) -> NDArray[np.int64]:
    """Where a group's values are among those of `groups`."""
    before = sum(len(values.groups[g]) for g in groups[: groups.index(group)])
    return before + np.arange(len(values.groups[group]))


def _all_values(rig: Rig) -> _Values:
    cameras, count = Cameras.of(rig.cameras), len(rig.cameras)
    width = max(camera.width for camera in rig.cameras)
    own = np.zeros((count, len(PARAMETERS), count))
    for number, name in enumerate(("fx", "fy")):
        own[np.arange(count), PARAMETERS.index(name), np.arange(count)] = cameras.lenses[:, number]
    freedom, groups = Freedom.none(count), {}

    def free(group: str, names: tuple[str, ...], prior_sd: float) -> None:
        nonlocal freedom
        for name in names:
            before = len(freedom.prior_sd)
            freedom = freedom.each(name, prior_sd)
            groups[group] = np.append(groups.get(group, np.zeros(0, dtype=np.int64)), np.arange(before, before + count))

    free("poses", PARAMETERS[:3], TURN_SD)
    free("poses", PARAMETERS[3:6], CENTER_SD_M)
    groups["focal"] = np.array([len(freedom.prior_sd)])
    freedom = freedom.shared_focal(cameras, FOCAL_SD)
    groups[OWN] = len(freedom.prior_sd) + np.arange(count)
    freedom = freedom.freed(own, OWN_FOCAL_SD)
    free(PRINCIPAL, ("cx", "cy"), PRINCIPAL_SD * width)
    free(K1, ("k1",), DISTORTION_SD)
    free(K2, ("k2",), DISTORTION_SD)
    return _Values(freedom, groups)


def _problem(sightings: Sightings, freedom: Freedom, sd_px: float, bend: float) -> Problem:
    sds = np.full(len(sightings), sd_px)
    observations = Observations(sightings.camera, sightings.pose, sightings.pixels, sds)
    return Problem(observations, freedom, Loss("huber", bend))


def noise_px(problem: Problem, state: State) -> float:
    """The standard deviation of a point's x or y, from the middle residual and the number of free values."""
    residuals = linearised(problem, state).residuals
    numbers, free = residuals.size, len(state.steps) + 6 * len(state.blocks)
    spread = 1.4826 * float(np.median(np.abs(residuals)))
    return max(spread * float(np.sqrt(numbers / max(numbers - free, 0.1 * numbers))), LEAST_PX)


def plain_covariance(problem: Problem, state: State) -> Floats:
    """Covariance [G, G] of the free values, for residuals that err independently by `sd_px`; priors included."""
    at = linearised(problem, state)
    folded = at.coupling @ np.linalg.inv(at.block_hessian)
    return np.asarray(np.linalg.inv(at.hessian - np.einsum("lgd,lhd->gh", folded, at.coupling, optimize=True)))
