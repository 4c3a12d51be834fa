"""Seeded, periodic, band-limited textures in 0..1: natural images' 1/f spectrum, alone or laid over a pattern."""

import numpy as np
from numpy.typing import NDArray

SIZE = 256  # texels a side
FINEST_PERIOD = 4  # texels; bilinear sampling needs about this much


def noise(rng: np.random.Generator, exponent: float = 1.0, coarsest: int = 4) -> NDArray[np.float32]:
    """Draw a texture [S, S] of amplitude 1 / f^`exponent`, from `coarsest` cycles a tile to the finest period.

    Its values use the range 0..1 evenly.
    """
    z = relief(rng, SIZE, exponent, (coarsest, SIZE / FINEST_PERIOD))
    return (0.5 + 0.5 * np.tanh(0.8 * z)).astype(np.float32)


def relief(rng: np.random.Generator, size: int, exponent: float, band: tuple[float, float]) -> NDArray[np.float64]:
    """Draw normal values [size, size] of variance 1 whose amplitude falls as 1 / f^`exponent`.

    `band` holds the least and the greatest frequency, in cycles a tile.
    """
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :]) * size
    inside = (frequency >= band[0]) & (frequency <= band[1])
    amplitude = np.where(inside, np.maximum(frequency, 1) ** -exponent, 0)
    field = np.fft.irfft2(amplitude * np.exp(2j * np.pi * rng.random(frequency.shape)), s=(size, size))
    return field / field.std()


def speckle(rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw blobs with steep borders and a little 1/f relief inside them."""
    blobs = np.tanh(3 * (noise(rng, exponent=0.8, coarsest=6) - 0.5))
    return _blend(blobs / np.abs(blobs).max() / 2 + 0.5, rng, 0.7)


def checks(rng: np.random.Generator, cells: int = 16) -> NDArray[np.float32]:
    """Draw `cells` squares a tile, alternating, over 1/f relief."""
    wave = np.sin(np.pi * cells * (np.arange(SIZE) + 0.5) / SIZE)
    return _blend(np.tanh(4 * wave[:, None] * wave[None, :]) / 2 + 0.5, rng, 0.6)


def stripes(rng: np.random.Generator, count: int = 12) -> NDArray[np.float32]:
    """Draw `count` slanted stripes a tile over 1/f relief."""
    turn = np.arange(SIZE) / SIZE
    wave = np.sin(2 * np.pi * (count * turn[None, :] + count / 3 * turn[:, None]))
    return _blend(np.tanh(2 * wave) / 2 + 0.5, rng, 0.6)


def build(rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw the textures of a scene [6, S, S]: even noise, detailed noise, speckle, checks, stripes, speckle."""
    return np.stack([noise(rng, exponent=1.15), noise(rng), speckle(rng), checks(rng), stripes(rng), speckle(rng)])


def _blend(pattern: NDArray, rng: np.random.Generator, weight: float) -> NDArray[np.float32]:
    return (weight * pattern + (1 - weight) * noise(rng)).astype(np.float32)
