"""Finds the gain of each camera from surfaces that several see. Letters: V views, H rows, W columns, n pixels.

Where two neighbouring views see one still surface, the median of the logarithm of the ratio of their light is the
difference of their log gains, whatever the surface looks like. All pairs are solved together by least squares; what all
views share cannot be seen, so log gains have the mean 0. Source: gain compensation of Brown & Lowe, "Automatic
panoramic image stitching using invariant features", IJCV 2007.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reconstruction.initialization.sweep import DepthMap, Image, neighbours
from reconstruction.initialization.warping import sampled
from reconstruction.parallel import each

DARKEST = 0.02  # spikes per tick of a pixel whose ratio is looked at
LEAST_PX = 400  # pixels that a pair of views must share
PATCH_PX = 49  # pixels of a sweep's window, in which depths err alike
LEAST_SD = 1e-3  # of a pair's log ratio: light differs a little by the direction it is seen from
MEDIAN_SD = 1.25  # deviation of a median over that of a mean
SURE = 4.0  # standard deviations by which gains must differ to be taken out
LEAST_SPREAD = 4e-3  # of log gains that is worth it: half of a real sensor's spread of thresholds
Mask = NDArray[np.bool_]
Seen = tuple[DepthMap, Image, Mask]


class Gains(NamedTuple):
    """Logarithms [V] of the gains of the views, of mean 0, and their deviations [V]; infinite where nothing tells."""

    logs: NDArray[np.float64]
    sds: NDArray[np.float64]

    @property
    def spread(self) -> float:
        """The root of the mean square of the logarithms."""
        return float(np.sqrt(np.mean(self.logs**2)))

    @property
    def determined(self) -> bool:
        """A flag: the views differ by more than doubt explains, and by enough to matter."""
        sd = float(np.sqrt(np.mean(self.sds**2)))
        return bool(np.isfinite(sd)) and self.spread > max(LEAST_SPREAD, SURE * sd)


def camera_gains(maps: Sequence[DepthMap], images: Sequence[Image], still: Sequence[Mask]) -> Gains:
    """Estimate the gains of V views from their still pictures [H, W], spikes per tick, and their depths.

    `still` [H, W] are the pixels that show one surface all along.
    """
    count = len(maps)
    pairs = []
    for i in range(count):
        others = [j for j in range(count) if j != i]
        pairs += [(i, others[k]) for k in neighbours(maps[i].camera, [maps[o].camera for o in others])]
    ratios = each(lambda pair: _ratio(*((maps[i], images[i], still[i]) for i in pair)), pairs)
    rows, values, weights = [], [], []
    for (i, j), (ratio, sd) in zip(pairs, ratios, strict=True):
        if np.isfinite(sd):
            row = np.zeros(count)
            row[[i, j]] = 1.0, -1.0
            rows.append(row)
            values.append(ratio)
            weights.append(1 / sd**2)
    return _solved(count, np.array(rows).reshape(-1, count), np.array(values), np.array(weights))


def _solved(count: int, rows: NDArray[np.float64], values: NDArray[np.float64], weights: NDArray[np.float64]) -> Gains:
    """Solve differences of log gains [P] by weighted least squares; errors are as large as what is left says."""
    unknown = Gains(np.zeros(count), np.full(count, np.inf))
    share = np.full((count, count), 1 / count)  # the mean, which no difference tells
    normal = rows.T @ (weights[:, None] * rows)
    if len(rows) < count or np.linalg.matrix_rank(normal) < count - 1:
        return unknown
    scale = float(np.trace(normal)) / count
    inverse = np.linalg.inv(normal + scale * share) - share / scale
    logs = inverse @ (rows.T @ (weights * values))
    left = values - rows @ logs
    excess = max(1.0, float(weights @ left**2) / max(1, len(rows) - count + 1))
    return Gains(logs - logs.mean(), np.sqrt(np.maximum(np.diag(inverse), 0) * excess))


def _ratio(one: Seen, another: Seen) -> tuple[float, float]:
    """Return the median log ratio of one view's light to the other's, and its deviation; infinite for too few."""
    (here, image, still), (other, others, _) = one, another
    there, visible = sampled(here.camera, here.depth, others, other)
    pixels = visible & still & (np.minimum(image, there) > DARKEST) & (np.maximum(image, there) < np.inf)
    found = int(pixels.sum())
    if found < LEAST_PX:
        return 0.0, np.inf
    ratios = np.log(image[pixels]) - np.log(there[pixels])
    median = float(np.median(ratios))
    spread = 1.4826 * float(np.median(np.abs(ratios - median)))
    return median, float(np.hypot(MEDIAN_SD * spread / np.sqrt(found / PATCH_PX), LEAST_SD))
