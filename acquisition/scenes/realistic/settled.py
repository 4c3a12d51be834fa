"""Draws light for truth: rays are added where two halves of them do not agree yet.

What cameras record is drawn with few rays, whose noise nobody could tell from a texture. A truth with that noise would
count it as an error of whatever is compared with it. Letters: H rows, W columns, N pixels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from acquisition.scenes.realistic.painter import COARSE_RAYS, Painter, paint
from acquisition.scenes.realistic.setting import Setting
from acquisition.scenes.realistic.studio import LEAST_CHANGE, REACH_PX
from rigs.camera import Camera

SIDE = 4  # rays a side of a pixel in each round
MOST_ROUNDS = 16  # an even number
NOISE = 0.0012  # standard deviation that is left, in spikes per tick: 54 dB below the white of these scenes
AROUND_PX = 5  # a side of the square whose pixels tell the noise of its middle
_ROUNDS, _COARSE = 1000, (2000, 2001)  # numbers of random places of rays; a studio's are small
Image = NDArray[np.float32]


class Settling:
    """A painter of truth, and what its cameras see of still things."""

    def __init__(self, setting: Setting):
        self._painter = Painter(setting)
        self._still: dict[Camera, Image] = {}

    def light(self, camera: Camera, instant_s: float) -> Image:
        """Return the light [H, W] before a camera at an instant, in spikes per tick."""
        painter, every = self._painter, np.arange(camera.width * camera.height, dtype=np.uint32)
        if camera not in self._still:
            self._still[camera] = settled(painter, painter.still, camera, every)
        painter.stand(instant_s)
        changed = self._changed(camera, every)
        return np.where(changed, settled(painter, painter.whole, camera, every[changed.ravel()]), self._still[camera])

    def _changed(self, camera: Camera, every: NDArray[np.uint32]) -> NDArray[np.bool_]:
        """Return the pixels [H, W] that movers or their shadows reach, where they stand now."""
        found = np.zeros(len(every), dtype=bool)
        for seed in _COARSE:
            with_them, without = (
                paint(self._painter, scene, camera, every, COARSE_RAYS, seed)
                for scene in (self._painter.whole, self._painter.still)
            )
            found |= (np.abs(with_them.light - without.light) > LEAST_CHANGE) | (with_them.covered > 0)
        return sums_around(found.reshape(camera.height, camera.width), 2 * REACH_PX + 1) > 0


def settled(painter: Painter, scene: Any, camera: Camera, pixels: NDArray[np.uint32]) -> Image:
    """Return the light [H, W] of `pixels` [N], numbers in row-major order, in one of the painter's scenes; 0 elsewhere.

    Every pixel has two rounds of rays. More are drawn while the halves of those around it tell more than NOISE, and
    MOST_ROUNDS are not over.
    """
    shape = camera.height, camera.width
    halves, drawn = np.zeros((2, shape[0] * shape[1])), np.zeros(shape[0] * shape[1])
    for number in range(0, MOST_ROUNDS, 2):
        for half in range(2):
            halves[half, pixels] += paint(painter, scene, camera, pixels, SIDE, _ROUNDS + number + half).light
        drawn[pixels] += 1
        first, second = (halves / np.maximum(drawn, 1)).reshape(2, *shape)
        pixels = pixels[noise_of(first, second, drawn.reshape(shape) > 0).ravel()[pixels] > NOISE]
    return (halves.sum(axis=0) / np.maximum(2 * drawn, 1)).reshape(shape).astype(np.float32)


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
