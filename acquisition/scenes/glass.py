"""The glass before a sensor: a lens that bends, light that is lost towards the corners, and points that spread.

Good lenses of machine vision bend by 1 to 10% at the corners, lose 10 to 40% of the light there, and spread a point
with a standard deviation of .3 to 1 pixels. The bend is drawn ray by ray; loss and spread come on top of the pixels.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import write_array
from acquisition.durable import write_json
from acquisition.errors import BadRecordingError
from rigs.camera import Camera
from rigs.lens import LEAST_NUMBERS, Lens
from rigs.rig import Rig

GLASS_FILE = "glass.json"  # the glass of all cameras in a truth folder
MOST_BARREL, MOST_PINCUSHION = 14.0, 50.0  # percent; with more barrel the corners have no picture (4/27)
REACH_SD, REACH_PX = 4.0, 4  # standard deviations of a blur that are drawn, and pixels beyond them
NUMBER = r"[-+]?(\d+(\.\d*)?|\.\d+)(e[-+]?\d+)?"
COUNTS = (2, 4, 5)  # of coefficients: k1 k2, with p1 p2, with k3
Image = NDArray[np.float32]


def _number(most: float, about: str) -> float:
    return field(default=0.0, metadata={"most": most, "about": about})


@dataclass(frozen=True)
class Glass:
    """Properties of the lenses of a rig; raises BadRecordingError for a number outside its range.

    `lens` is "10%", the barrel at the corners (negative: pincushion), or OpenCV's k1,k2,p1,p2,k3, of which two, four
    or five are given. A bend of p percent brings the corner of a straight picture p percent nearer to the middle.
    """

    lens: str = ""
    lens_spread: float = _number(1.0, "Let lenses differ: spread the bend of each by this share (standard deviation).")
    vignetting: float = _number(0.9, "Darken the corners by this share against the middle; the mean stays.")
    blur: float = _number(5.0, "Spread every point over a Gaussian of so many pixels (standard deviation).")

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if f.metadata and not 0 <= value <= f.metadata["most"]:
                raise BadRecordingError(f"found {f.name} {value}", f"0 to {f.metadata['most']:g}")
        if self.lens and not self._percent and not self._coefficients:
            raise BadRecordingError(f"found the lens {self.lens!r}", "10%, or k1,k2 or k1,k2,p1,p2 or k1,k2,p1,p2,k3")
        if self._percent and not -MOST_PINCUSHION <= float(self._percent[1]) <= MOST_BARREL:
            expected = f"-{MOST_PINCUSHION:g}% to {MOST_BARREL:g}%"
            raise BadRecordingError(f"found the lens {self.lens}", expected, "more barrel leaves corners dark")
        if self.lens_spread and not self.lens:
            raise BadRecordingError("found lens_spread without a lens", "a lens", "give one, such as 10%")

    @property
    def spoils(self) -> bool:
        """Tell whether light is lost or spread."""
        return bool(self.vignetting or self.blur)

    def bent(self, rig: Rig, seed: int) -> Rig:
        """Return the rig with the lens before each of its cameras; raises BadRecordingError where it folds in one."""
        if not self.lens:
            return rig
        factors = 1 + self.lens_spread * np.random.default_rng([seed, 0x1E]).standard_normal(len(rig.cameras))
        return replace(rig, cameras=tuple(map(self._bent, rig.cameras, factors.tolist())))

    def pane(self, camera: Camera) -> Pane | None:
        """Return what the light of one camera passes; None where nothing is lost or spread."""
        return Pane(camera, self.vignetting, self.blur) if self.spoils else None

    def _bent(self, camera: Camera, factor: float) -> Camera:
        corner = _corner(camera)
        k1 = -float(self._percent[1]) / 100 / (corner @ corner) if self._percent else 0.0
        bent = tuple(factor * k for k in self._coefficients or (k1, 0.0, 0.0, 0.0))
        camera = replace(camera, distortion=bent, lens_model="opencv")
        edges = np.array([(x, y) for x in (0, camera.width) for y in (0, camera.height)], dtype=np.float64)
        if not np.isfinite(camera.slopes(edges)).all():
            found = f"found a lens that folds inside the picture ({', '.join(f'{k:.3g}' for k in bent)})"
            raise BadRecordingError(found, "one ray for each pixel", "bend or spread it less", where=camera.id)
        return camera

    @cached_property
    def _percent(self) -> re.Match[str] | None:
        return re.fullmatch(f"({NUMBER})%", self.lens)

    @cached_property
    def _coefficients(self) -> tuple[float, ...]:
        parts = [part.strip() for part in self.lens.split(",")]
        if len(parts) not in COUNTS or not all(re.fullmatch(NUMBER, part) for part in parts):
            return ()
        return Lens("opencv", (*map(float, parts), *(0.0,) * (LEAST_NUMBERS - len(parts)))).coefficients


PERFECT = Glass()


@dataclass(frozen=True, eq=False)
class Pane:
    """The loss and the spread of light before one camera.

    Light falls off as behind a lens that shades by cos^4: (1 + a r^2)^-2 at the distance r from the principal point,
    with the share `vignetting` lost at the farthest corner. The exposure makes up for it: the mean over the pixels is
    one, as in maps of their gains. Beyond the edge a picture goes on as its edge.
    """

    camera: Camera
    vignetting: float
    blur: float

    @cached_property
    def shares(self) -> Image:
        """The light [H, W] that arrives, as a share of that of a mean pixel."""
        rows, columns = np.indices((self.camera.height, self.camera.width)) + 0.5
        corner = _corner(self.camera) * (self.camera.fx, self.camera.fy)
        square = ((columns - self.camera.cx) ** 2 + (rows - self.camera.cy) ** 2) / (corner @ corner)
        shares = (1 + square * ((1 - self.vignetting) ** -0.5 - 1)) ** -2
        return (shares / shares.mean()).astype(np.float32)

    def passed(self, light: Image) -> Image:
        """Return the light [n, H, W] that arrives of `light` [n, H, W]."""
        light = spread(light, self.blur) if self.blur else light
        return light * self.shares if self.vignetting else light


def spread(light: NDArray[np.floating], sd: float) -> NDArray[Any]:
    """Return images [n, H, W] spread along rows and columns with the standard deviation `sd` in px.

    The weights are Lindeberg's discrete analogue of the Gaussian (PAMI 1990): their deviation is exact however small,
    and one spread after another is one of the root of both squares.
    """
    weights = discrete_gaussian(sd)
    reach = len(weights) // 2
    for axis in (1, 2):
        size = light.shape[axis]
        padded = np.pad(light, [(reach, reach) if a == axis else (0, 0) for a in range(3)], mode="edge")
        cuts = [[slice(None)] * axis + [slice(k, k + size)] for k in range(len(weights))]
        light = np.zeros_like(light)
        for weight, cut in zip(weights.astype(light.dtype), cuts, strict=True):
            light += weight * padded[tuple(cut)]
    return light


def discrete_gaussian(sd: float) -> NDArray[np.float64]:
    """Return weights [2 r + 1] that are positive and sum to one: exp(-t) I_n(t) of the variance t, by its spectrum."""
    reach = REACH_PX + math.ceil(REACH_SD * sd)
    size = 16 * reach
    weights = np.fft.irfft(np.exp(sd * sd * (np.cos(2 * np.pi * np.arange(size // 2 + 1) / size) - 1)), size)
    kept = np.maximum(np.roll(weights, reach)[: 2 * reach + 1], 0)
    return kept / kept.sum()


def write_glass(folder: Path, glass: Glass, cameras: Iterable[Camera]) -> None:
    """Write beside the truth in `folder` what the glass does to light, which the truth itself is without.

    `glass.json` has the numbers; `camRC/vignetting.npy` (float32 [H, W]) the light of pixels, as shares of that of the
    mean one. What the lens of a camera bends is in `cameras.json`.
    """
    write_json(folder / GLASS_FILE, asdict(glass))
    for camera in cameras if glass.vignetting else ():
        write_array(folder / camera.id / "vignetting.npy", Pane(camera, glass.vignetting, 0.0).shares)


def _corner(camera: Camera) -> NDArray[np.float64]:
    """Return the slope [2] at which a straight picture has the corner that is farthest from its principal point."""
    x, y = max(camera.cx, camera.width - camera.cx), max(camera.cy, camera.height - camera.cy)
    return np.array([x / camera.fx, y / camera.fy])
