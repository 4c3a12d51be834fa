"""The outcome of every calibration of a rig's cameras, and how far cameras are from where they were drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reconstruction.calibration.adjustment import Solution
from rigs.camera import Camera
from rigs.rig import Calibration, Rig
from rigs.transform import Floats, rotvec_of

INLIER_PX = 1.0  # residual up to which an observation counts as explained


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
        residuals = solution.residuals_px()
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
