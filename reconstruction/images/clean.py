"""Ground truth in place of images from spikes: what the rest of the engine reaches when the images are given.

`clean` images are the light of one instant, `blurred` ones the mean light of the exposure of an ordinary camera.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from reconstruction.images.composite import CompositeSource

GIVEN = ("clean", "blurred")  # images that no spikes were turned into


@dataclass(frozen=True, eq=False)
class CleanSource(CompositeSource):
    """One camera's given images by plane, spikes per tick; masks and counts are those of its spikes all the same."""

    frames: Mapping[int, NDArray[np.float32]] = field(default_factory=dict)

    def at(self, plane: int) -> NDArray[np.float32]:
        """The given image [H, W] at `plane`; KeyError where there is none."""
        return self.frames[plane]

    def instants(self, stride: int) -> NDArray[np.int64]:
        """The planes that have one."""
        return np.array(sorted(self.frames), dtype=np.int64)
