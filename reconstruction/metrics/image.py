"""PSNR and SSIM of linear images against truth, over all pixels or a mask."""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torchmetrics.functional.image import structural_similarity_index_measure

Image = NDArray[np.float32]


def psnr_db(image: Image, truth: Image, white: float, mask: NDArray[np.bool_] | None = None) -> float:
    """Peak signal-to-noise ratio in dB with data range `white`; infinite for equal images, NaN for an empty mask."""
    error = (image.astype(np.float64) - truth.astype(np.float64)) ** 2
    mean = float(np.mean(error if mask is None else error[mask])) if mask is None or mask.any() else math.nan
    return math.inf if mean == 0 else -10 * math.log10(mean / white**2)


def ssim(image: Image, truth: Image, white: float, mask: NDArray[np.bool_] | None = None) -> float:
    """Structural similarity: Gaussian window of sigma 1.5, population covariance, data range `white`."""
    x, y = (torch.from_numpy(np.ascontiguousarray(a, dtype=np.float32))[None, None] for a in (image, truth))
    result = structural_similarity_index_measure(x, y, sigma=1.5, data_range=white, return_full_image=True)
    full = result[1][0, 0].numpy()
    if mask is None:
        return float(full.mean())
    return float(full[mask].mean()) if mask.any() else math.nan
