"""The image that every spike-to-image method returns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigs.camera import Camera


@dataclass(frozen=True, eq=False)
class Estimate:
    """Linear intensity [H, W] float32 in spikes per tick, always finite; `valid` [H, W] where it is no mere bound.

    `sigma` [H, W] float32: one standard deviation of the intensity in spikes per tick under constant light, from the
    quantisation to whole spikes and ticks and from shot noise (`noise`); finite. It knows nothing of motion blur.
    """

    intensity: NDArray[np.float32]
    valid: NDArray[np.bool_]
    sigma: NDArray[np.float32]


def shrunk(image: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Average an image down to the size of `camera`."""
    import cv2

    small = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)
