"""Seeded, periodic, band-limited textures in 0..1: natural images' 1/f spectrum, alone or laid over a pattern."""

import numpy as np
from numpy.typing import NDArray

SIZE = 256  # texels a side
FINEST_PERIOD = 4  # texels; bilinear sampling needs about this much


def noise(rng: np.random.Generator, exponent: float = 1.0, coarsest: int = 4) -> NDArray[np.float32]:
    """Amplitude 1 / f^`exponent` from `coarsest` cycles a tile to the finest period; values spread evenly [S, S]."""
    frequency = np.hypot(np.fft.fftfreq(SIZE)[:, None], np.fft.rfftfreq(SIZE)[None, :]) * SIZE
    band = (frequency >= coarsest) & (frequency <= SIZE / FINEST_PERIOD)
    amplitude = np.where(band, np.maximum(frequency, 1) ** -exponent, 0)
    spectrum = amplitude * np.exp(2j * np.pi * rng.random(frequency.shape))
    field = np.fft.irfft2(spectrum, s=(SIZE, SIZE))
    return _spread(field)


def speckle(rng: np.random.Generator) -> NDArray[np.float32]:
    """Blobs with steep borders and a little 1/f relief inside them."""
    blobs = np.tanh(3 * (noise(rng, exponent=0.8, coarsest=6) - 0.5))
    return _blend(blobs / np.abs(blobs).max() / 2 + 0.5, rng, 0.7)


def checks(rng: np.random.Generator, cells: int = 16) -> NDArray[np.float32]:
    """`cells` squares a tile, alternating, over 1/f relief."""
    wave = np.sin(np.pi * cells * (np.arange(SIZE) + 0.5) / SIZE)
    return _blend(np.tanh(4 * wave[:, None] * wave[None, :]) / 2 + 0.5, rng, 0.6)


def stripes(rng: np.random.Generator, count: int = 12) -> NDArray[np.float32]:
    """`count` slanted stripes a tile over 1/f relief."""
    turn = np.arange(SIZE) / SIZE
    wave = np.sin(2 * np.pi * (count * turn[None, :] + count / 3 * turn[:, None]))
    return _blend(np.tanh(2 * wave) / 2 + 0.5, rng, 0.6)


def build(rng: np.random.Generator) -> NDArray[np.float32]:
    """The set a scene chooses from [6, S, S]: even noise, noise rich in detail, speckle, checks, stripes, speckle."""
    return np.stack([noise(rng, exponent=1.15), noise(rng), speckle(rng), checks(rng), stripes(rng), speckle(rng)])


def _blend(pattern: NDArray, rng: np.random.Generator, weight: float) -> NDArray[np.float32]:
    return (weight * pattern + (1 - weight) * noise(rng)).astype(np.float32)


def _spread(field: NDArray) -> NDArray[np.float32]:
    """A smooth squeeze of about normal values into 0..1 that uses the range evenly."""
    z = field / field.std()
    return (0.5 + 0.5 * np.tanh(0.8 * z)).astype(np.float32)
