"""Takes pictures of movers at several instants. A textured thing that passes through the volume is a wand.

Cameras are synchronised, so each instant of a mover gives correspondences of its own, where plain walls give none.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.recording.reader import Recording
from acquisition.spikes.stream import SpikeStream
from reconstruction.calibration.features import Image, repaired
from reconstruction.images.background import moving_pixels
from reconstruction.images.flicker import estimate_light
from reconstruction.images.methods.interpolated import interpolated

MOMENTS = 8
HALF_WINDOW = 8  # planes; 4 and 16 gave the same poses in a plain room, within their deviations
SMOOTH_PX = 0.7  # against the noise of so few planes


@dataclass(frozen=True, eq=False)
class Moment:
    """The images of all views around one instant, by camera id, and which pixels [H, W] of each see a mover."""

    images: Mapping[str, Image]
    moving: Mapping[str, NDArray[np.bool_]]


Movers = Callable[[], Sequence[Moment]]  # takes the pictures, which not every scene needs


def movers_of(recording: Recording, views: Sequence[str], count: int = MOMENTS) -> Movers:
    """Return what takes pictures of a recording's movers in the `views`, at `count` instants evenly apart."""

    def take() -> list[Moment]:
        streams = {view: recording.stream(view) for view in views}
        light = estimate_light(list(streams.values()))
        moving = {view: moving_pixels(stream, light) for view, stream in streams.items()}
        if not any(mask.any() for mask in moving.values()):
            return []
        planes = np.linspace(0, recording.planes, count + 2)[1:-1].astype(int).tolist()
        return [Moment({v: _picture(s, plane) for v, s in streams.items()}, moving) for plane in planes]

    return take


def _picture(stream: SpikeStream, plane: int) -> Image:
    light = repaired(interpolated(stream, plane, HALF_WINDOW).intensity)
    return np.asarray(cv2.GaussianBlur(light, (0, 0), SMOOTH_PX), np.float32)
