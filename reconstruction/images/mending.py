"""Fills in pixels that say nothing. Letters: H rows, W columns, K pixels to fill in."""

import cv2
import numpy as np
from numpy.typing import NDArray

_AROUND = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx]


def mended(image: NDArray[np.float32], bad: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Replace the `bad` pixels [H, W] of an image by the median of the good ones among their eight neighbours.

    One without any takes the nearest good pixel; an image without a good pixel stays as it is.
    """
    if not bad.any() or bad.all():
        return image
    found = image.astype(np.float32)
    rows, columns = np.nonzero(bad)
    known = np.pad(np.where(bad, np.nan, found), 1, constant_values=np.nan)
    around = np.stack([known[rows + 1 + dy, columns + 1 + dx] for dy, dx in _AROUND])  # [8, K]
    alone = np.isnan(around).all(axis=0)
    found[rows[~alone], columns[~alone]] = _median(around[:, ~alone])
    if alone.any():
        nearest = nearest_good(bad)
        found[rows[alone], columns[alone]] = image.ravel()[nearest[rows[alone], columns[alone]]]
    return found


def _median(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the medians [K] of columns [n, K] without their NaN; np.nanmedian takes ten times as long.

    Each column has a number.
    """
    ordered, known = np.sort(values, axis=0), np.count_nonzero(~np.isnan(values), axis=0)  # NaN comes last
    low, high = (np.take_along_axis(ordered, middle[None], axis=0)[0] for middle in ((known - 1) // 2, known // 2))
    return (low + high) / 2


def nearest_good(bad: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the index [H, W], row by row, of the good pixel that is nearest to each pixel; some must be good."""
    _, found = cv2.distanceTransformWithLabels(
        bad.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    labels = np.asarray(found, dtype=np.int64)
    pixel_of = np.empty(int(labels.max()) + 1, dtype=np.int64)
    pixel_of[labels[~bad]] = np.flatnonzero(~bad)
    return pixel_of[labels]
