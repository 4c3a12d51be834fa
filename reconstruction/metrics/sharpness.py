"""How much of the true edges an image keeps, over all pixels or a mask."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
EDGE_SHARE = 0.1  # of the masked pixels: those where truth is steepest


def edge_sharpness(image: Image, truth: Image, mask: NDArray[np.bool_] | None = None) -> float:
    """The image's gradient along the truth's over the truth's own, least squares over the steepest masked pixels.

    1 where every edge is as steep as in truth, less where it is blurred or elsewhere, 0 where there is none; noise
    hardly moves it. Sobel 3x3. NaN where the mask is empty or the truth has no edge in it.
    """
    kept = np.ones(truth.shape, dtype=bool) if mask is None else mask
    dx, dy = _gradient(truth)
    steepness = np.hypot(dx, dy)
    if not kept.any() or not steepness[kept].any():
        return math.nan
    edge = kept & (steepness >= np.quantile(steepness[kept], 1 - EDGE_SHARE)) & (steepness > 0)
    ix, iy = _gradient(image)
    return float((ix * dx + iy * dy)[edge].sum() / np.square(steepness[edge]).sum())


def _gradient(image: Image) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    values = image.astype(np.float64)
    return cv2.Sobel(values, -1, 1, 0).astype(np.float64), cv2.Sobel(values, -1, 0, 1).astype(np.float64)
