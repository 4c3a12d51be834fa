"""The outcome of every calibration of a rig's cameras, how sure it is, and how far they are from where they were drawn.

Uncertainties leave out what no camera can tell: place, turn and scale of the whole. Letters: C cameras, G free values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reconstruction.calibration.adjustment import Solution, linearised
from reconstruction.calibration.problem import Freedom
from reconstruction.calibration.projection import PARAMETERS, Cameras
from rigs.camera import Camera
from rigs.rig import Calibration, Rig
from rigs.transform import Floats, cross_matrices, rotvec_of

INLIER_PX = 1.0  # residual up to which an observation counts as explained
POSE = 6
OPTIMISM = 2.0  # variances are taken for so much larger than the sandwich says; on some scenes that is too much


@dataclass(frozen=True)
class CameraSd:
    """One standard deviation of each figure found about a camera, as the adjustment's covariance has it.

    `rotation_deg` and `center_m` are the root of the sum of the three axes' variances.
    """

    rotation_deg: float
    center_m: float
    focal_percent: float


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A rig with calibrated poses, how sure of them one can be, and what is left over.

    `sd` and `residuals` go by camera id; residuals are arrays [n, 4] of x, y, dx, dy in pixels: where a point was seen
    and how far from there the calibrated camera sees it. `report` holds plain values that can be written as JSON.
    """

    rig: Rig
    sd: dict[str, CameraSd]
    report: dict[str, object]
    residuals: dict[str, Floats]


class Fit(NamedTuple):
    """The fit of cameras to O observations: `residuals` [O, 2] in px, which are `good` [O], and `rms_px` of those."""

    residuals: Floats
    good: NDArray[np.bool_]
    rms_px: float

    @classmethod
    def of(cls, solution: Solution) -> Fit:
        """Return the fit of a solution; an infinite `rms_px` where no observation is good."""
        residuals = linearised(solution.problem, solution.state).residuals
        good = np.linalg.norm(residuals, axis=1) < INLIER_PX
        rms = float(np.sqrt((residuals[good] ** 2).sum(axis=1).mean())) if good.any() else np.inf
        return cls(residuals, good, rms)


class Displacement(NamedTuple):
    """The way of a camera from another place: the angle of the turn and the distance of the centres."""

    turn_deg: float
    shift_m: float


def displacement(found: Camera, drawn: Camera) -> Displacement:
    """Return how far the camera `found` is from where it was `drawn`, both in the rig frame."""
    turn = rotvec_of(found.cam_from_rig.rotation @ drawn.cam_from_rig.rotation.T)
    return Displacement(float(np.degrees(np.linalg.norm(turn))), float(np.linalg.norm(found.center - drawn.center)))


def calibrated(
    rig: Rig, found: Rig, solution: Solution, fit: Fit, sds: Sequence[CameraSd], report: dict[str, object]
) -> Calibrated:
    """Return `rig` with the cameras `found`, in the order of the solution's, and what the `report` has to say of them.

    The report has the calibration's `date` in ISO form, which moves to the rig.
    """
    sd_deg = float(np.mean([sd.rotation_deg for sd in sds]))
    calibration = Calibration(str(report.pop("date")), fit.rms_px, sd_deg)
    new = {camera.id: camera for camera in found.cameras}
    cameras = tuple(new.get(camera.id, camera) for camera in rig.cameras)
    observations = solution.problem.observations
    report |= {
        "observations": len(observations),
        "kept_share": float(fit.good.mean()),
        "residual_px": fit.rms_px,
        "rotation_sd_deg": sd_deg,
    }
    rows = np.concatenate([observations.pixels, fit.residuals], axis=1)
    by_camera = {c: rows[fit.good & (observations.camera == i)] for i, c in enumerate(found.ids)}
    whole = replace(rig, cameras=cameras, poses="calibrated", calibration=calibration)
    return Calibrated(whole, dict(zip(found.ids, sds, strict=True)), report, by_camera)


def camera_sds(covariance: Floats, freedom: Freedom, cameras: Cameras, *, metric: bool) -> list[CameraSd]:
    """Return every camera's deviations from the covariance [G, G] of the free values; `metric`: scale is known."""
    count, parameters = len(cameras), len(PARAMETERS)
    mixing = freedom.mixing.reshape(count * parameters, freedom.mixing.shape[2])
    spread = (mixing @ covariance @ mixing.T).reshape(count, parameters, count, parameters)
    poses = spread[:, :POSE, :, :POSE].reshape(count * POSE, count * POSE)
    left = aligning(cameras, metric=metric)
    variances = OPTIMISM * np.diag(left @ poses @ left.T).reshape(count, POSE)
    focal = OPTIMISM * np.array([spread[c, POSE, c, POSE] for c in range(count)]) / cameras.lenses[:, 0] ** 2
    return [
        CameraSd(float(np.degrees(np.sqrt(v[:3].sum()))), float(np.sqrt(v[3:].sum())), float(100 * np.sqrt(f)))
        for v, f in zip(variances, focal, strict=True)
    ]


def aligning(cameras: Cameras, *, metric: bool) -> Floats:
    """Return the matrix [6C, 6C] that takes the mean turn, shift and (unless `metric`) scale out of steps [C, 6].

    It is `rigs.similarity.align` for small steps.
    """
    count = len(cameras)
    apart = cameras.centers - cameras.centers.mean(axis=0)
    turns, centers = np.zeros((count, 3, count, POSE)), np.zeros((count, 3, count, POSE))
    for c in range(count):
        turns[c, :, c, :3] = cameras.rotations[c].T  # in rig axes
        centers[c, :, c, 3:] = np.eye(3)
    mean = turns.mean(axis=0)
    turns = turns - mean
    centers = centers - np.einsum("cij,jdp->cidp", cross_matrices(apart), mean)  # a turn of the whole carries them
    centers = centers - centers.mean(axis=0)
    variance = float((apart**2).sum())
    if not metric and variance > 0:
        scale = np.einsum("ci,cidp->dp", apart, centers) / variance
        centers = centers - apart[:, :, None, None] * scale
    own = np.einsum("cij,cjdp->cidp", cameras.rotations, turns)
    steps = np.concatenate([own, centers], axis=1)
    return np.asarray(steps.reshape(count * POSE, count * POSE), dtype=np.float64)
