"""Scores of images without a truth to compare with: BRISQUE and NIQE, from parameters that the user brings.

No maintained wheel ships the parameters of both (the one with BRISQUE's builds libsvm from source), and nothing is
downloaded. BRISQUE is OpenCV's, with its sample files `brisque_model_live.yml` and `brisque_range_live.yml`; NIQE is
worked out here, with the published pristine model as BasicSR's `niqe_pris_params.npz` holds it. Lower is better.
Sources: Mittal et al., "No-reference image quality assessment in the spatial domain", TIP 2012; Mittal et al., "Making
a completely blind image quality analyzer", SPL 2013.

Letters: P patches, F = 36 features (18 at each of two scales).
"""

import math
from pathlib import Path
from zipfile import BadZipFile

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import read_arrays
from reconstruction.errors import BadRunError

PATCH = 96
_SHAPES = np.arange(0.2, 10.001, 0.001)  # shapes of a generalised Gaussian that are tried
_gammas = [np.array([math.gamma(k / shape) for shape in _SHAPES]) for k in (1, 2, 3)]
_RATIOS = _gammas[1] ** 2 / (_gammas[0] * _gammas[2])
Pixels = NDArray[np.uint8]


def brisque(pixels: Pixels, model: Path, spans: Path) -> float:
    """Return OpenCV's BRISQUE of 8-bit grey `pixels` [H, W]; raises BadRunError for parameters that cannot be read."""
    try:
        judge = getattr(cv2.quality, "QualityBRISQUE_compute")  # noqa: B009  OpenCV's type stubs lack it
        return float(judge(pixels, str(model), str(spans))[0])
    except cv2.error as error:
        raise BadRunError(f"found no BRISQUE model ({error.err})", "OpenCV's with its range", where=model) from error


class Niqe:
    """Distance of an image's patches from pristine ones; raises BadRunError for a file without the model."""

    def __init__(self, parameters: Path):
        try:
            stored = read_arrays(parameters)
            self._mean = np.asarray(stored["mu_pris_param"], dtype=np.float64).ravel()
            self._spread = np.asarray(stored["cov_pris_param"], dtype=np.float64)
            if self._mean.shape != (36,) or self._spread.shape != (36, 36):
                raise ValueError(f"{self._mean.shape}, {self._spread.shape}")
        except (OSError, KeyError, ValueError, TypeError, EOFError, BadZipFile) as error:
            wanted = "mu_pris_param [36] and cov_pris_param [36, 36]"
            raise BadRunError(f"found no NIQE model ({error})", wanted, where=parameters) from error

    def __call__(self, pixels: Pixels) -> float:
        """Return the NIQE of an 8-bit grey image [H, W]; NaN for one with less than two patches of 96 pixels."""
        features = niqe_features(pixels)
        if len(features) < 2:
            return math.nan
        apart = self._mean - features.mean(axis=0)
        both = np.linalg.pinv((self._spread + np.cov(features, rowvar=False)) / 2)
        return float(np.sqrt(apart @ both @ apart))


def niqe_features(pixels: Pixels) -> NDArray[np.float64]:
    """Return features [P, 36] of the whole patches of an 8-bit image [H, W], without patches of infinite ones."""
    rows, columns = (side // PATCH for side in pixels.shape)
    image = pixels[: rows * PATCH, : columns * PATCH].astype(np.float64)
    if not rows * columns:
        return np.empty((0, 36))
    scales = []
    for scale in (1, 2):
        side = PATCH // scale
        patches = _even(image).reshape(rows, side, columns, side).swapaxes(1, 2).reshape(-1, side, side)
        scales.append(np.array([_patch_features(patch) for patch in patches]))
        image = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA).astype(np.float64)
    features = np.concatenate(scales, axis=1)
    return features[np.isfinite(features).all(axis=1)]


def _even(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the image [H, W] without its local mean and contrast (7x7 Gaussian of 7/6 px)."""
    mean, power = (cv2.GaussianBlur(a, (7, 7), 7 / 6, borderType=cv2.BORDER_REPLICATE) for a in (image, image**2))
    return (image - mean) / (np.sqrt(np.abs(power - mean**2)) + 1)


def _patch_features(patch: NDArray[np.float64]) -> list[float]:
    """Return shape and width of the values, then shape, mean and both widths of products with four neighbours."""
    shape, left, right = fit_asymmetric(patch)
    found = [shape, (left + right) / 2]
    for shift in ((0, 1), (1, 0), (1, 1), (1, -1)):
        shape, left, right = fit_asymmetric(patch * np.roll(patch, shift, axis=(0, 1)))
        found += [shape, (right - left) * math.gamma(2 / shape) / math.gamma(1 / shape), left, right]
    return found


def fit_asymmetric(values: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return shape, left and right width of the asymmetric generalised Gaussian with the moments of `values`."""
    below, above = values[values < 0], values[values > 0]
    if not below.size or not above.size:
        return math.nan, math.nan, math.nan
    left, right = math.sqrt(np.mean(below**2)), math.sqrt(np.mean(above**2))
    skew = left / right
    ratio = np.mean(np.abs(values)) ** 2 / np.mean(values**2)
    ratio *= (skew**3 + 1) * (skew + 1) / (skew**2 + 1) ** 2
    shape = float(_SHAPES[np.argmin((_RATIOS - ratio) ** 2)])
    width = math.sqrt(math.gamma(1 / shape) / math.gamma(3 / shape))
    return shape, left * width, right * width
