"""The share of the true edges that an image keeps."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
EDGE_SHARE = 0.1  # share of the masked pixels that count as edges: the steepest ones


def edge_sharpness(image: Image, truth: Image, mask: NDArray[np.bool_] | None = None) -> float:
    """Return the least-squares ratio of the image's gradient to the truth's, over the steepest masked pixels.

    Images are [H, W]. 1 where every edge is as steep as in truth, less where it is blurred or displaced, 0 where there
    is none; noise hardly changes it. Sobel 3x3. NaN where the mask [H, W] is empty or the truth has no edge in it.
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
