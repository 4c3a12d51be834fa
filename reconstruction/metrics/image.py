"""PSNR, SSIM and sharpness of linear images against truth, over all pixels or a mask."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
WINDOW, SIGMA = 11, 1.5  # px
K1, K2 = 0.01, 0.03
EDGE_SHARE = 0.1  # share of the masked pixels that count as edges: the steepest ones


def psnr_db(image: Image, truth: Image, white: float, mask: NDArray[np.bool_] | None = None) -> float:
    """Return the peak signal-to-noise ratio in dB of images [H, W] with data range `white`.

    Infinite for equal images, NaN for an empty mask [H, W].
    """
    error = (image.astype(np.float64) - truth.astype(np.float64)) ** 2
    mean = float(np.mean(error if mask is None else error[mask])) if mask is None or mask.any() else math.nan
    return math.inf if mean == 0 else -10 * math.log10(mean / white**2)


def ssim_map(image: Image, truth: Image, white: float) -> NDArray[np.float64]:
    """Return the structural similarity [H, W] of images [H, W] with data range `white`.

    The window is a Gaussian of 1.5 px, the covariance that of the population.

    Source: Wang et al., "Image quality assessment: from error visibility to structural similarity", TIP 2004, eq. 13.
    """
    x, y = image.astype(np.float64), truth.astype(np.float64)
    mean_x, mean_y = _blurred(x), _blurred(y)
    xx, yy = (_blurred(a * a) - mean * mean for a, mean in ((x, mean_x), (y, mean_y)))
    xy = _blurred(x * y) - mean_x * mean_y
    c1, c2 = (K1 * white) ** 2, (K2 * white) ** 2
    likeness = (2 * mean_x * mean_y + c1) * (2 * xy + c2)
    return likeness / ((mean_x**2 + mean_y**2 + c1) * (np.maximum(xx, 0) + np.maximum(yy, 0) + c2))


def mean_over(values: NDArray[np.float64], mask: NDArray[np.bool_] | None) -> float:
    """Return the mean over all pixels [H, W] or a mask; NaN for an empty one."""
    if mask is None:
        return float(values.mean())
    return float(values[mask].mean()) if mask.any() else math.nan


def _blurred(image: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(cv2.GaussianBlur(image, (WINDOW, WINDOW), SIGMA, borderType=cv2.BORDER_REFLECT_101), np.float64)


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
