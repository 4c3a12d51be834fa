"""Checks whether a stored calibration still fits what the cameras see today, and finds the camera that has moved."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from acquisition.progress import Progress, silent
from reconstruction.calibration.calibrated import Calibrated, displacement
from reconstruction.calibration.features import Image
from reconstruction.calibration.moments import Movers
from reconstruction.calibration.natural import calibrate_natural
from rigs.rig import Rig, object_distance_m
from rigs.similarity import align

SDS = 4.0  # largest difference of a camera that fits, in standard deviations
TURN_DEG, SHIFT_SHARE, FOCAL_PERCENT = 0.05, 1e-3, 0.5  # differences that always fit: a third of a pixel


@dataclass(frozen=True)
class CameraCheck:
    """The way of today's camera from the stored one, after alignment on the cameras that fit, or on all."""

    camera: str
    turn_deg: float
    shift_m: float
    focal_percent: float
    fits: bool


def check_rig(
    rig: Rig,
    images: Mapping[str, Image],
    date: str,
    progress: Progress = silent,
    *,
    movers: Movers | None = None,
) -> tuple[Calibrated, list[CameraCheck]]:
    """Calibrate from today's images, and compare each camera of `rig` that has one with where it is stored.

    Where no two stand to each other as they are stored, all are compared after alignment on all. Raises GeometryError
    where today's scene does not tell.
    """
    today = calibrate_natural(rig, images, date, progress=progress, movers=movers)
    kept = every = [c for c in rig.ids if c in images]
    while True:
        checks = _compared(rig, today, kept)
        off = [c for c in checks if not c.fits and c.camera in kept]
        if not off:
            return today, checks
        if len(kept) <= 2:
            return today, _compared(rig, today, every)
        worst = max(off, key=lambda c: c.turn_deg + np.degrees(c.shift_m / object_distance_m(rig.cameras)))
        kept = [c for c in kept if c != worst.camera]


def _compared(rig: Rig, today: Calibrated, kept: list[str]) -> list[CameraCheck]:
    moved = align(today.rig.only(kept), rig).carry_rig(today.rig)
    distance_m = object_distance_m(rig.cameras)
    checks = []
    for camera_id, sd in today.sd.items():
        now, then = moved.camera(camera_id), rig.camera(camera_id)
        turn, shift = displacement(now, then)
        focal = 100 * abs(now.fx / then.fx - 1)
        fits = (
            turn <= max(TURN_DEG, SDS * sd.rotation_deg)
            and shift <= max(SHIFT_SHARE * distance_m, SDS * sd.center_m)
            and focal <= max(FOCAL_PERCENT, SDS * sd.focal_percent)
        )
        checks.append(CameraCheck(camera_id, turn, shift, focal, fits))
    return checks
