"""Draws periodic textures with the statistics of photographs; their 1/f spectrum reaches to the single texel.

Dead leaves: opaque leaves of every size, the small ones as much of the picture as the large ones, fall on one another
at random; that gives the sharp outlines, the occlusions and the 1/f amplitude spectrum of natural pictures (Lee,
Mumford and Huang, "Occlusion models for natural images", IJCV 2001). Values are in 256 steps, so that rounding differs
on no processor.
"""

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.textures import relief

SIZE = 512  # texels a side
OCTAVES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)  # least half sizes in texels; the leaves of each reach twice as far
LEAST_LIGHT = 0.08  # the darkest leaf; the lightest reflects 1
GRAIN = 0.35  # standard deviation of the relief on the leaves, in natural logarithm
COVER = 1.2  # how many times the leaves of one octave would cover the picture


def leaves(rng: np.random.Generator, *, square: bool = False) -> NDArray[np.float32]:
    """Draw discs, or upright rectangles where `square`, of log-uniform lightness under 1/f grain; 0..1 [S, S]."""
    counts = [max(1, int(COVER * SIZE**2 / (7 * low**2))) for low in OCTAVES]
    falls = np.split(rng.permutation(sum(counts)) + 1, np.cumsum(counts)[:-1])  # when each leaf falls; 0: never
    latest = np.zeros(SIZE * SIZE, dtype=np.int64)
    for low, fallen in zip(OCTAVES, falls, strict=True):
        np.maximum(latest, _fall(rng, np.sort(fallen), low, square), out=latest)
    shades = np.exp(rng.uniform(np.log(LEAST_LIGHT), 0, sum(counts) + 1))
    return _steps(shades[latest].reshape(SIZE, SIZE) * np.exp(GRAIN * _relief(rng)))


def _fall(rng: np.random.Generator, fallen: NDArray[np.int64], low: float, square: bool) -> NDArray[np.int64]:
    """Return when the top leaf of each texel fell [S * S]; the leaves have half sizes from `low` to 2 `low` texels."""
    count, reach = len(fallen), int(2 * low) + 1
    half = low * rng.uniform(1, 2, (count, 1)) * (rng.uniform(0.5, 1, (count, 2)) if square else 1)
    center = rng.uniform(0, SIZE, (count, 2))
    first = np.floor(center).astype(np.int64)
    steps = np.arange(-reach, reach + 1)
    across, down = (((first + steps[:, None, None] - center) / half) ** 2).transpose(2, 1, 0)  # [count, steps] each
    x, y = ((first + steps[:, None, None]) % SIZE).transpose(2, 1, 0)
    shape = np.maximum if square else np.add
    leaf, row, column = np.nonzero(shape(down[:, :, None], across[:, None, :]) <= 1)
    on_top = np.zeros(SIZE * SIZE, dtype=np.int64)
    np.maximum.at(on_top, y[leaf, row] * SIZE + x[leaf, column], fallen[leaf])
    return on_top


def cloth(rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw 1/f relief alone, to the texel, of log-normal light; 0..1 [S, S]."""
    return _steps(np.exp(0.65 * _relief(rng)))


def _relief(rng: np.random.Generator) -> NDArray[np.float64]:
    return relief(rng, SIZE, exponent=1.1, band=(3, np.inf))


def _steps(light: NDArray[np.float64]) -> NDArray[np.float32]:
    """Scale the light so that all but its brightest fiftieth is below 1, and round it to 256 steps."""
    lightest = np.quantile(light, 0.98)
    return (np.round(np.clip(light / lightest, 0, 1) * 255) / 255).astype(np.float32)
