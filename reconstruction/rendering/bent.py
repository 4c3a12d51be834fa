"""Shows through a lens that bends what a pinhole sees: rendered in the view that covers the picture, then bent."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from reconstruction.lenses.straight import straightening, view_of
from reconstruction.scene_model import View
from rigs.camera import Camera


def seen_through(camera: Camera, look: Callable[[Camera], View]) -> View:
    """Return what `camera` sees, from a `look` that shows a pinhole; raises RigError where no pinhole covers its lens.

    Light is the mean over each pixel, depth that of the pixel of the pinhole that takes most of it.
    """
    if not camera.bends:
        return look(camera)
    pinhole = view_of(camera)
    seen, way = look(pinhole), straightening(camera, pinhole)
    return View(way.bent(seen.intensity), way.nearest(seen.depth))


def image_through(camera: Camera, look: Callable[[Camera], NDArray[np.float32]]) -> NDArray[np.float32]:
    """Return the image [H, W] that `camera` has of something, from a `look` that shows a pinhole; raises RigError."""
    if not camera.bends:
        return look(camera)
    pinhole = view_of(camera)
    return straightening(camera, pinhole).bent(look(pinhole))
