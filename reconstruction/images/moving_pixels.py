"""Finds the pixels that ever see something change, by the count test.

Under constant light, counts over equal windows differ by at most one spike plus shot noise. A pixel whose counts spread
wider, over long windows (slow change) or short ones (a brief passage), is moving.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.flicker import Light

WINDOWS = (4, 16)  # equal windows the clip is cut into, once for slow and once for brief change
SPREAD = 3  # smallest spread of counts that constant light does not explain
GROW_PX = 2  # a mover's edge is soft: its neighbours see it too


def moving_pixels(stream: SpikeStream, light: Light) -> NDArray[np.bool_]:
    """Find the pixels [H, W] that change somewhere in the stream by more than `light` does."""
    seen = np.zeros((stream.layout.height, stream.layout.width), dtype=np.uint8)
    for windows in WINDOWS:
        length = len(stream) // windows
        if length < SPREAD:
            continue
        spans = [(i * length, (i + 1) * length) for i in range(windows)]
        counts = np.stack([stream.counts(*span) / np.float32(light.over(*span)) for span in spans])
        shot = np.sqrt(counts.mean(axis=0)) * 0.05
        coarsest = SPREAD / min(light.over(*span) for span in spans)
        seen |= (np.ptp(counts, axis=0) >= coarsest + shot).astype(np.uint8)
    seen = cv2.medianBlur(seen, 3)  # a lone flickering pixel is the sensor's, not the scene's
    return cv2.dilate(seen, np.ones((2 * GROW_PX + 1,) * 2, dtype=np.uint8)).astype(bool)
