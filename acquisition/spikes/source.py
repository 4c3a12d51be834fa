"""Sources of a camera's planes that need no hardware."""

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.layout import PlaneLayout


class PlaneSource(Protocol):
    """Yields one camera's planes in order; exhausted when fewer come back than were asked for."""

    layout: PlaneLayout

    def next_planes(self, count: int) -> NDArray[np.uint8]:
        """Return the next packed planes [n, B] with n <= count."""
        ...


@runtime_checkable
class Adjustable(Protocol):
    """A source whose camera can be told to give more or fewer spikes for the same light."""

    sensitivity: float
