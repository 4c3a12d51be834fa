"""Draws light until it settles: rays are added where two halves of them do not agree yet.

Nobody could tell the noise of few rays from a texture, in what cameras record and in what it is compared with.
Letters: H rows, W columns, N pixels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from acquisition.scenes.realistic.painter import Painter, paint
from rigs.camera import Camera

SIDE = 4  # rays a side of a pixel in each round
MOST_ROUNDS = 16  # an even number
NOISE = 0.0012  # standard deviation that is left, in spikes per tick: 54 dB below the white of these scenes
AROUND_PX = 5  # a side of the square whose pixels tell the noise of its middle
_ROUNDS = 1000  # first number of random places of rays; a studio's are small


def settled(painter: Painter, scene: Any, camera: Camera, pixels: NDArray[np.uint32]) -> NDArray[np.float32]:
    """Return the light [N] of `pixels` [N], numbers in row-major order, in one of the painter's scenes.

    Every pixel has two rounds of rays. More are drawn while the halves of those around it tell more than NOISE, and
    MOST_ROUNDS are not over.
    """
    shape, left = (camera.height, camera.width), pixels
    halves, drawn = np.zeros((2, shape[0] * shape[1])), np.zeros(shape[0] * shape[1])
    for number in range(0, MOST_ROUNDS, 2):
        for half in range(2):
            halves[half, left] += paint(painter, scene, camera, left, SIDE, _ROUNDS + number + half).light
        drawn[left] += 1
        first, second = (halves / np.maximum(drawn, 1)).reshape(2, *shape)
        left = left[noise_of(first, second, drawn.reshape(shape) > 0).ravel()[left] > NOISE]
    return (halves[:, pixels].sum(axis=0) / (2 * drawn[pixels])).astype(np.float32)


def noise_of(half: NDArray[np.float64], other: NDArray[np.float64], drawn: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the deviation [H, W] of the mean of two halves [H, W], by those that are `drawn` in the square around."""
    squares = sums_around(np.square(half - other) / 4 * drawn, AROUND_PX)
    return np.sqrt(np.maximum(squares, 0) / np.maximum(sums_around(drawn, AROUND_PX), 1))


def sums_around(image: NDArray, side: int) -> NDArray[np.float64]:
    """Return the sum [H, W] over the square of `side` pixels, an odd number, around each pixel; 0 beyond the border."""
    total = np.pad(image.astype(np.float64), side // 2)
    for axis in (0, 1):
        total = sliding_window_view(total, side, axis=axis).sum(axis=-1)
    return total
