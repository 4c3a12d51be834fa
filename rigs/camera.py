"""One camera of a rig. OpenCV axes (x right, y down, z forward); the first pixel's centre is (0.5, 0.5)."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rigs.errors import RigError
from rigs.transform import Floats, Transform


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with OpenCV distortion (k1, k2, p1, p2); lengths in pixels, `cam_from_rig` in metres.

    `pixels` is the file with the gain, offset and defects of its pixels, where they were measured. The id names files,
    so it consists of letters, digits, `_` and `-`. Raises RigError, naming the camera, for another id, a size or focal
    length that is not positive, or a number that is not finite.
    """

    id: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    cam_from_rig: Transform
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    serial: str = ""
    pixels: Path | None = None

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", self.id):
            raise RigError(f"found the camera id {self.id!r}", "letters, digits, _ and -, such as cam01")
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not all(math.isfinite(n) for n in numbers):
            raise RigError("found intrinsics with NaN or infinity", "finite numbers", where=self.id)
        if self.fx <= 0 or self.fy <= 0:
            raise RigError(f"found focal lengths {self.fx}, {self.fy}", "positive pixels", where=self.id)
        if self.width < 1 or self.height < 1:
            raise RigError(f"found the size {self.width}x{self.height}", "at least 1x1", where=self.id)

    @property
    def K(self) -> Floats:  # noqa: N802
        """The calibration matrix [3, 3] in pixels."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    @property
    def center(self) -> Floats:
        """The camera centre in the rig frame [3], metres."""
        return self.cam_from_rig.center

    def project(self, points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Project points [N, 3] of the rig frame, in metres, as a pinhole does, without distortion.

        Returns their places in the picture [N, 2] in pixels, NaN for points that are not in front of the camera, and
        which of them lie inside the picture [N].
        """
        x, y, z = self.cam_from_rig.apply(points).T
        depth = np.where(z > 0, z, np.nan)
        pixels = np.stack([self.fx * x / depth + self.cx, self.fy * y / depth + self.cy], axis=1)
        inside = np.logical_and(pixels >= 0, pixels < (self.width, self.height))
        return pixels, inside[:, 0] & inside[:, 1]

    def scaled(self, width: int, height: int) -> Camera:
        """Return the same lens over a sensor of another size in pixels; their calibration holds for one size only."""
        sx, sy = width / self.width, height / self.height
        pixels = self.pixels if (sx, sy) == (1, 1) else None
        lens = {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}
        return replace(self, width=width, height=height, pixels=pixels, **lens)
