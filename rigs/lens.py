"""Bends slopes to places as OpenCV's two lens models do, and back, in float64, and knows where lenses fold.

Letters: N points. A slope is (x / z, y / z) of a ray in camera axes, a bent place what the calibration matrix is
applied to. `opencv` is Brown's model ("Close-range camera calibration", 1971): radial k1 k2 k3, tangential p1 p2.
`fisheye` is Kannala and Brandt's (PAMI 2006): an odd polynomial of the angle off the axis. Either has a radius, in
slopes or in rad, beyond which the polynomial turns back: there the lens folds, and what lies beyond has no picture.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from rigs.errors import RigError
from rigs.transform import Floats

LensModel = Literal["opencv", "fisheye"]
NAMES: dict[LensModel, tuple[str, ...]] = {
    "opencv": ("k1", "k2", "p1", "p2", "k3"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
LEAST_NUMBERS = 4  # coefficients of either model; the fifth of `opencv` may be left out
MOST = 1e9  # largest coefficient that the arithmetic bears
STEEPEST = 100.0  # slope beyond which nothing is seen: 89.4 degrees off the axis
BISECTIONS, NEWTONS = 200, 30  # most steps of the inverse
EXACT = 1e-9  # error of an inverse, in slopes, beyond which there is none


def shortened(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    """Return the coefficients of an `opencv` or `fisheye` lens without a fifth that is zero."""
    return coefficients if any(coefficients[LEAST_NUMBERS:]) else coefficients[:LEAST_NUMBERS]


@dataclass(frozen=True)
class Lens:
    """A lens `model` with its coefficients, as NAMES orders them; all zeros are a pinhole for `opencv` alone.

    Raises RigError for another model, a number of coefficients that is not the model's, or one beyond MOST.
    """

    model: LensModel
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.model not in get_args(LensModel):
            raise RigError(f"found the lens model {self.model!r}", f"one of {', '.join(get_args(LensModel))}")
        names, count = NAMES[self.model], len(self.coefficients)
        if not LEAST_NUMBERS <= count <= len(names):
            raise RigError(f"found {count} numbers of distortion", f"{' '.join(names)} of a lens {self.model}")
        if not all(math.isfinite(k) for k in self.coefficients):
            raise RigError("found distortion with NaN or infinity", "finite numbers")
        if max(map(abs, self.coefficients)) > MOST:
            raise RigError(f"found distortion of {max(map(abs, self.coefficients)):g}", f"at most {MOST:g}")

    @property
    def bends(self) -> bool:
        """Tell whether the lens does anything a pinhole does not."""
        return self.model == "fisheye" or any(self.coefficients)

    @functools.cached_property
    def radial(self) -> Floats:
        """The factors of r^3, r^5, ... in the bent radius, where r is a slope or, of a fisheye, an angle in rad."""
        k = (*self.coefficients, 0.0)
        return np.array(k[:4] if self.model == "fisheye" else (k[0], k[1], k[4]), dtype=np.float64)

    @functools.cached_property
    def fold(self) -> float:
        """The radius, in slopes or in rad, at which the lens folds; where it does not, the one that is still seen."""
        most = math.atan(STEEPEST) if self.model == "fisheye" else STEEPEST
        slope = np.append(1.0, self.radial * np.arange(3, 2 * len(self.radial) + 2, 2))  # derivative, in powers of r^2
        scaled = slope * (most * most) ** np.arange(len(slope))
        while len(scaled) > 1 and abs(scaled[-1]) < np.finfo(float).eps:
            scaled = scaled[:-1]  # too small to matter up to `most`
        roots = np.roots(scaled[::-1])
        real = roots[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)].real
        return float(most * math.sqrt(min(1.0, real.min(initial=1.0))))

    @property
    def steepest(self) -> float:
        """The slope at which the lens folds, or the largest that is seen."""
        return math.tan(self.fold) if self.model == "fisheye" else self.fold

    def bent(self, slopes: Floats) -> Floats:
        """Return the bent places [N, 2] of slopes [N, 2]; NaN for those at the fold or beyond."""
        seen = np.hypot(*slopes.T) < self.steepest
        places, slope = self._bent(np.where(seen[:, None], slopes, 0.0))
        seen &= _determinant(slope) > 0
        return np.where(seen[:, None], places, np.nan)

    def straightened(self, places: Floats) -> Floats:
        """Return the slopes [N, 2] whose bent places are `places` [N, 2]; NaN for places that no ray reaches."""
        places = np.asarray(places, dtype=np.float64)
        radius = np.hypot(*places.T)
        turned = self._unbent(radius)
        length = np.tan(turned) if self.model == "fisheye" else turned
        slopes = places * np.where(radius == 0, 1.0, length / np.where(radius == 0, 1.0, radius))[:, None]
        if self.model == "fisheye" or not any(self.coefficients[2:4]):
            return slopes
        return self._settled(slopes, places)

    def _settled(self, slopes: Floats, places: Floats) -> Floats:
        """Return the slopes after Newton's steps in two dimensions, which the tangential part asks for."""
        with np.errstate(all="ignore"):
            edge = places / np.maximum(np.hypot(*places.T), 1e-300)[:, None] * (0.99 * self.fold)
            slopes = np.where(np.isfinite(slopes), slopes, edge)  # tangential parts may still bring it inside
            for _ in range(NEWTONS):
                found, slope = self._bent(slopes)
                determinant, (u, v) = _determinant(slope), (found - places).T
                across = slope[:, 1, 1] * u - slope[:, 0, 1] * v
                down = slope[:, 0, 0] * v - slope[:, 1, 0] * u
                step = np.stack([across, down], axis=1) / np.where(determinant == 0, 1, determinant)[:, None]
                slopes = slopes - step
                if not (np.abs(step).max(axis=1) > 1e-15 * np.abs(places).max(axis=1)).any():
                    break
            off = np.abs(self.bent(slopes) - places).max(axis=1)
            good = off <= EXACT * (1 + np.abs(places).max(axis=1))
        return np.where(good[:, None], slopes, np.nan)

    def _unbent(self, radius: Floats) -> Floats:
        """Return the radius (slope or rad) before the radial polynomial bent it to `radius` [N]; NaN beyond the fold.

        Newton's method between bounds that bisection tightens: the polynomial grows all the way to the fold.
        """
        low, high = np.zeros_like(radius), np.full_like(radius, self.fold)
        most = float(self._grown(np.array([self.fold]))[0][0])
        found = np.where(radius < most, np.minimum(radius, 0.5 * self.fold), np.nan)
        for _ in range(BISECTIONS):
            value, slope = self._grown(found)
            low, high = np.where(value <= radius, found, low), np.where(value >= radius, found, high)
            with np.errstate(all="ignore"):
                step = found - (value - radius) / slope
            inside = (step >= low) & (step <= high)
            following = np.where(np.isnan(found), np.nan, np.where(inside, step, (low + high) / 2))
            moved, found = np.abs(following - found), following
            if not (moved > 4 * np.finfo(float).eps * found).any():
                break
        return found

    def _grown(self, radius: Floats) -> tuple[Floats, Floats]:
        """Return the radial polynomial of `radius` [N] and its derivative."""
        square, value, slope = radius * radius, np.zeros_like(radius), np.zeros_like(radius)
        for power, k in reversed(list(enumerate(self.radial, start=1))):
            value, slope = (value + k) * square, (slope + (2 * power + 1) * k) * square
        return radius * (1 + value), 1 + slope

    def _bent(self, slopes: Floats) -> tuple[Floats, Floats]:
        """Return the bent places [N, 2] and their derivatives by the slopes [N, 2, 2], folded or not."""
        if self.model == "fisheye":
            return bent_by_fisheye(slopes, self.coefficients)
        return bent_by_opencv(slopes, (*self.coefficients, 0.0)[:5])


def _determinant(matrices: Floats) -> Floats:
    """Return the determinants [N] of matrices [N, 2, 2]."""
    return matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0]


def bent_by_opencv(slopes: Floats, coefficients: Sequence[Floats | float]) -> tuple[Floats, Floats]:
    """Return the bent places [N, 2] and their derivatives by `slopes` [N, 2, 2]; k1 k2 p1 p2 k3 are numbers or [N]."""
    (x, y), (k1, k2, p1, p2, k3) = slopes.T, coefficients
    square = x * x + y * y
    factor = 1 + square * (k1 + square * (k2 + square * k3))
    bend = 2 * (k1 + square * (2 * k2 + 3 * k3 * square))  # derivative of `factor` by x is x times this
    u = x * factor + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    v = y * factor + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    across = bend * x * y + 2 * p1 * x + 2 * p2 * y
    rows = (
        np.stack([factor + bend * x * x + 2 * p1 * y + 6 * p2 * x, across], axis=-1),
        np.stack([across, factor + bend * y * y + 6 * p1 * y + 2 * p2 * x], axis=-1),
    )
    return np.stack([u, v], axis=-1), np.stack(rows, axis=-2)


def bent_by_fisheye(slopes: Floats, coefficients: Sequence[Floats | float]) -> tuple[Floats, Floats]:
    """Return the bent places [N, 2] and their derivatives by `slopes` [N, 2, 2]; k1 k2 k3 k4 are numbers or [N]."""
    angle, ratio, falls = fisheye_angles(slopes)
    grows, slope, square = np.ones_like(angle), np.zeros_like(angle), angle * angle
    for power, k in enumerate(coefficients, start=1):
        grows = grows + k * square**power
        slope = slope + 2 * power * k * square ** (power - 1)
    factor = ratio * grows
    bend = falls * grows + ratio * slope * ratio / (1 + (slopes * slopes).sum(axis=-1))
    outer = slopes[..., :, None] * slopes[..., None, :]
    return slopes * factor[..., None], factor[..., None, None] * np.eye(2) + bend[..., None, None] * outer


def fisheye_angles(slopes: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the angle [N] off the axis in rad; that over the slope's length r; and that quotient's slope over r."""
    square = (slopes * slopes).sum(axis=-1)
    small = square < 1e-8  # here the series of the quotients are the better numbers
    safe = np.where(small, 1.0, square)
    angle = np.arctan(np.sqrt(square))
    ratio = np.where(small, 1 - square / 3, angle / np.sqrt(safe))
    return angle, ratio, np.where(small, 0.8 * square - 2 / 3, (1 / (1 + square) - ratio) / safe)
