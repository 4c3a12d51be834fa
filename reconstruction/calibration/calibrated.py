"""What every calibration of a rig's cameras returns."""

from __future__ import annotations

from dataclasses import dataclass

from rigs.rig import Rig
from rigs.transform import Floats


@dataclass(frozen=True)
class CameraSd:
    """One standard deviation of what was found about a camera, as the adjustment's covariance has it.

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
