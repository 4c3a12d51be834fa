"""Defines case 28: cameras that no observation determines, and a covariance that must say so.

Points are seen by the lab rig's nine places with noise of 0.1 px. Where axes are parallel, a longer focal length and a
scene as much deeper give the same pictures: then all that is known of the focal length is its prior.
"""

import math
from dataclasses import replace

import numpy as np

from reconstruction.calibration.adjustment import covariance
from reconstruction.calibration.calibrated import OPTIMISM, CameraSd, camera_sds
from reconstruction.calibration.natural import CENTER_SD_M, FOCAL_SD
from reconstruction.calibration.problem import Freedom, Loss, Observations, Problem, ScenePoints, State
from reconstruction.calibration.projection import Cameras, project
from reconstruction.calibration.verdict import MOST_SD_DEG, refuse_unsure
from reconstruction.errors import GeometryError
from reconstruction.stability.case import Case, Observation, refusal
from rigs.toml import catalog_rig
from rigs.transform import Floats

POINTS, NOISE_PX = 150, 0.1
DEEP_M, FLAT_M = (1.3, 3.0), (2.0, 2.0)
PRIOR_PERCENT = 100 * FOCAL_SD * math.sqrt(OPTIMISM)  # reported error of a focal length that nothing determines


def _cameras(*, parallel: bool) -> Cameras:
    cameras = Cameras.of(catalog_rig("lab3x3").cameras)
    if not parallel:
        return cameras
    level = cameras.centers * (1, 1, 0)
    return replace(cameras, rotations=np.broadcast_to(np.eye(3), cameras.rotations.shape).copy(), centers=level)


def _seen(cameras: Cameras, depths_m: tuple[float, float], freedom: Freedom) -> tuple[Problem, State]:
    """Return a problem and its true state: every point is seen by every camera."""
    rng, count = np.random.default_rng(28), len(cameras)
    across = rng.uniform((-0.5, -0.3), (0.5, 0.3), (POINTS, 2))
    points = np.concatenate([across, rng.uniform(*depths_m, (POINTS, 1))], axis=1)
    camera, block = np.repeat(np.arange(count), POINTS), np.tile(np.arange(POINTS), count)
    pixels = project(points[block], cameras, camera).pixels
    noisy = pixels + rng.normal(0, NOISE_PX, pixels.shape)
    observations = Observations(camera, block, noisy, np.full(len(camera), NOISE_PX))
    return Problem(observations, freedom, Loss()), State(cameras, ScenePoints(points), np.zeros(len(freedom.prior_sd)))


def _freedom(cameras: Cameras, focal_sd: float = FOCAL_SD) -> Freedom:
    return Freedom.poses(len(cameras), CENTER_SD_M).shared_focal(cameras, focal_sd)


def _sds(cameras: Cameras, depths_m: tuple[float, float]) -> list[CameraSd]:
    problem, state = _seen(cameras, depths_m, _freedom(cameras))
    return camera_sds(covariance(problem, state), problem.freedom, cameras, metric=False)


def _parallel(_: str) -> Observation:
    known, unknown = (_sds(_cameras(parallel=p), DEEP_M)[0].focal_percent for p in (False, True))
    said = f"parallel {unknown:.3f} %, of which the prior {PRIOR_PERCENT:.3f}; converging {known:.3f} %"
    return Observation(said, abs(unknown / PRIOR_PERCENT - 1) if known < PRIOR_PERCENT / 3 else math.inf)


def _without_prior(_: str) -> Observation:
    """Leave the focal length free of prior and pictures; no small error of it may be reported."""
    cameras = _cameras(parallel=True)
    problem, state = _seen(cameras, DEEP_M, _freedom(cameras, np.inf))
    try:
        sds = camera_sds(covariance(problem, state), problem.freedom, cameras, metric=False)
    except GeometryError:
        return Observation("refused: the observations leave it free", 0.0)
    return Observation(f"focal length to {sds[0].focal_percent:.3g} %", math.inf)


def _flat(_: str) -> Observation:
    """Look at a flat scene with parallel axes, where a turn and a shift look alike; the verdict must refuse."""
    cameras = _cameras(parallel=True)
    deep, flat = (float(np.mean([sd.rotation_deg for sd in _sds(cameras, d)])) for d in (DEEP_M, FLAT_M))
    refused = refusal(lambda: refuse_unsure(_sds(cameras, FLAT_M))) is not None
    said = f"turns to {flat:.3f} degrees, {deep:.3f} were it deep; {'refused' if refused else 'taken'}"
    return Observation(said, 0.0 if refused == (flat >= MOST_SD_DEG) and flat > 2 * deep else math.inf)


def _whole(problem: Problem, state: State) -> Floats:
    """Return the covariance [G, G] from the normal equations of cameras and points together, nothing eliminated."""
    observations = problem.observations
    positions, _ = state.blocks.place(observations.block)
    seen = project(positions, state.cameras, observations.camera)
    free = problem.freedom.mixing.shape[2]
    rows = np.zeros((len(observations), 2, free + 3 * len(state.blocks)))
    rows[:, :, :free] = seen.by_camera @ problem.freedom.mixing[observations.camera]
    for o, block in enumerate(observations.block):
        rows[o, :, free + 3 * block : free + 3 * block + 3] = seen.by_point[o]
    rows = rows / observations.sd_px[:, None, None]
    residuals = (seen.pixels - observations.pixels) / observations.sd_px[:, None]
    prior = np.zeros(rows.shape[2])
    prior[:free] = 1 / problem.freedom.prior_sd**2
    flat = rows.reshape(-1, rows.shape[2])
    bread = np.linalg.inv(flat.T @ flat + np.diag(prior))
    by_block = np.zeros((len(state.blocks), rows.shape[2]))
    np.add.at(by_block, observations.block, np.einsum("ork,or->ok", rows, residuals))
    whole = bread @ (by_block.T @ by_block + np.diag(prior)) @ bread
    return np.asarray(whole[:free, :free], dtype=np.float64)


def _covariances(_: str) -> Observation:
    error, said = 0.0, []
    for parallel, depths_m in ((False, DEEP_M), (False, FLAT_M), (True, DEEP_M), (True, FLAT_M)):
        cameras = _cameras(parallel=parallel)
        problem, state = _seen(cameras, depths_m, _freedom(cameras))
        found, expected = covariance(problem, state), _whole(problem, state)
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        error = max(error, float(np.abs((found - expected) / scale).max()))
        said.append(f"{100 * math.sqrt(expected[-1, -1]):.2f}")
    return Observation(f"focal to {', '.join(said)} %: {error:.1e} off", error)


CASES = (
    Case(28, "parallel rig, free focal length", "no better known than by its prior", 1e-2, _parallel),
    Case(28, "parallel rig, no prior either", "refused, not a small error", 0.0, _without_prior),
    Case(28, "flat scene", "worse than a deep one; refused", 0.0, _flat),
    Case(28, "the covariance itself", "as with nothing eliminated", 1e-5, _covariances),
)
