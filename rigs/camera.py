"""One camera of a rig. OpenCV axes (x right, y down, z forward); the first pixel's centre is (0.5, 0.5)."""

from __future__ import annotations

import functools
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rigs.errors import RigError
from rigs.lens import Lens, LensModel
from rigs.transform import Floats, Transform


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera with one of OpenCV's lenses (`rigs.lens`); lengths in pixels, `cam_from_rig` in metres.

    `distortion` is k1, k2, p1, p2 and perhaps k3; of a `lens_model` fisheye k1, k2, k3, k4. `pixels` is the file with
    the gain, offset and defects of its pixels, where they were measured. The id names files, so it consists of letters,
    digits, `_` and `-`. Raises RigError, naming the camera, for another id, a size or focal length that is not
    positive, a number that is not finite, or distortion that no lens has.
    """

    id: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    cam_from_rig: Transform
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    serial: str = ""
    pixels: Path | None = None
    lens_model: LensModel = "opencv"

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
        with RigError.located(self.id):
            _ = self.lens  # refuses what no lens can have

    @functools.cached_property
    def lens(self) -> Lens:
        """The lens between the pinhole and the pixels."""
        return Lens(self.lens_model, tuple(float(k) for k in self.distortion))

    @property
    def bends(self) -> bool:
        """Tell whether the lens does anything a pinhole does not."""
        return self.lens.bends

    @property
    def K(self) -> Floats:  # noqa: N802
        """The calibration matrix [3, 3] in pixels."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    @property
    def center(self) -> Floats:
        """The camera centre in the rig frame [3], metres."""
        return self.cam_from_rig.center

    def project(self, points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Project points [N, 3] of the rig frame, in metres, through the lens.

        Returns their places in the picture [N, 2] in pixels, NaN for points that are not in front of the camera or lie
        beyond the fold of its lens, and which of them lie inside the picture [N].
        """
        x, y, z = self.cam_from_rig.apply(points).T
        depth = np.where(z > 0, z, np.nan)
        if self.bends:
            x, y, depth = *self.lens.bent(np.stack([x / depth, y / depth], axis=1)).T, 1.0
        pixels = np.stack([self.fx * x / depth + self.cx, self.fy * y / depth + self.cy], axis=1)
        inside = np.logical_and(pixels >= 0, pixels < (self.width, self.height))
        return pixels, inside[:, 0] & inside[:, 1]

    def slopes(self, pixels: NDArray[np.floating]) -> Floats:
        """Return where places [N, 2] in px look: x / z and y / z [N, 2] in camera axes, NaN where no ray reaches."""
        places = (np.asarray(pixels, dtype=np.float64) - (self.cx, self.cy)) / (self.fx, self.fy)
        return self.lens.straightened(places) if self.bends else places

    def straightened(self, pixels: NDArray[np.floating]) -> Floats:
        """Return where the pinhole without the lens sees what is seen at places [N, 2] in px; NaN where none is."""
        places = np.asarray(pixels, dtype=np.float64)
        return self.slopes(places) * (self.fx, self.fy) + (self.cx, self.cy) if self.bends else places

    def bent(self, pixels: Floats) -> Floats:
        """Return where the lens shows what the pinhole without it sees at places [N, 2] in px; NaN beyond its fold."""
        if not self.bends:
            return pixels
        slopes = (np.asarray(pixels, dtype=np.float64) - (self.cx, self.cy)) / (self.fx, self.fy)
        return self.lens.bent(slopes) * (self.fx, self.fy) + (self.cx, self.cy)

    def pinhole(self) -> Camera:
        """Return the same camera without the bend of its lens."""
        return replace(self, distortion=(0.0,) * 4, lens_model="opencv") if self.bends else self

    def halved(self) -> Camera:
        """Return the same lens over pixels of twice the width and height; an odd last row or column is left out."""
        even = replace(self, width=self.width // 2 * 2, height=self.height // 2 * 2)
        return even.scaled(self.width // 2, self.height // 2)

    def scaled(self, width: int, height: int) -> Camera:
        """Return the same lens over a sensor of another size in pixels; their calibration holds for one size only."""
        sx, sy = width / self.width, height / self.height
        pixels = self.pixels if (sx, sy) == (1, 1) else None
        lens = {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}
        return replace(self, width=width, height=height, pixels=pixels, **lens)
