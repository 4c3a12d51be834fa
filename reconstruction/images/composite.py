"""The best statistic for each pixel: everything recorded where nothing moves, a short image where something does."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.background import Background, mended
from reconstruction.images.light import Light
from reconstruction.images.methods import Method

DIFFERENT = 0.03  # spikes per tick, mean of 3x3: five deviations of a 33-plane TFP's quantisation
GROW_PX = 2


@dataclass(frozen=True, eq=False)
class CompositeSource:
    """One camera's target images under `light`: its background, but a short image by `method` where `moving` [H, W]."""

    stream: SpikeStream
    background: Background
    moving: NDArray[np.bool_]
    method: Method
    light: Light

    def at(self, plane: int) -> NDArray[np.float32]:
        """The image [H, W] at `plane`, spikes per tick."""
        image = self.background.image * self.light.gains[plane]
        if not self.moving.any():
            return image
        np.copyto(image, self.method(self.stream, plane).intensity, where=self.moving)
        return mended(image, self.background.stuck)

    def movers(self, plane: int) -> NDArray[np.bool_]:
        """Pixels [H, W] that see a mover at `plane`: unlike the background, or without one to compare with."""
        return self.movers_in(self.at(plane), plane)

    def movers_in(self, image: NDArray[np.float32], plane: int) -> NDArray[np.bool_]:
        """`movers`, where the image [H, W] at `plane` is at hand."""
        gap = cv2.blur(image - self.background.image * self.light.gains[plane], (3, 3))
        unlike = cv2.dilate((np.abs(gap) > DIFFERENT).astype(np.uint8), np.ones((2 * GROW_PX + 1,) * 2, np.uint8))
        return self.moving & ((unlike > 0) | ~self.background.trusted)
