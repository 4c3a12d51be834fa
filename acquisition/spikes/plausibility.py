"""Tells how likely a layout is to be that of a file: rightly read, pixels are like those beside them, and stay so.

Three correlations are multiplied. Wrong rows make pixels unlike those below. A wrong bit order makes them unlike those
across byte boundaries. Planes of a wrong size make counts unlike those of later planes, or take the contrast from their
mean. Of a real recording of a car at 400x250 the product is 0.79 read rightly and 0.75 in the wrong bit order; read at
400x200 it is 0.72, with two thirds of the contrast.

Letters: T planes, B bytes of a plane, H rows, W columns.
"""

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import Bytes, window_means

MOST_PLANES = 128  # planes worth reading; more are blurred by what moves
_LEAST_PLANES, _LEAST_PAIRS = 8, 50  # fewest that tell anything


def plausibility(packed: Bytes, layout: PlaneLayout) -> tuple[float, float]:
    """Return how alike pixels and their neighbours are, 1 at best, and the contrast of the planes' mean.

    Both are 0 where the planes [T, B] are too few or too even to tell.
    """
    planes = len(packed)
    if planes < _LEAST_PLANES:
        return 0.0, 0.0
    halves = np.array([[0, planes // 2], [planes // 2, 2 * (planes // 2)]])
    early, late = window_means(packed, layout, halves)
    mean = (early + late) / 2
    pixel = np.arange(layout.height)[:, None] * layout.stored_width + np.arange(1, layout.width)
    across = pixel % 8 == 0
    pairs = (mean[1:], mean[:-1]), (mean[:, 1:][across], mean[:, :-1][across]), (early, late)
    alike = float(np.prod([max(0.0, _correlation(a, b)) for a, b in pairs]))
    return alike, float(mean.std() / max(mean.mean(), 1e-9))


def _correlation(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    if a.size < _LEAST_PAIRS or not a.std() or not b.std():
        return 0.0
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])
