"""Says what every renderer gives: the frames that one camera sees of a scene at any instants.

Letters: n instants, H rows, W columns. A lens, a blur or a vignette is a View around another View.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress
from acquisition.scenes.motion import Floats, Vector
from rigs.camera import Camera


@dataclass(frozen=True)
class Frames:
    """Images of one camera at n instants, pixel (0, 0) at the top left.

    `intensity` [n, H, W] is linear light in spikes per tick, the mean over s x s rays a pixel. `depth` [n, H, W] is the
    distance along z in metres of the pixel's centre ray (NaN where nothing is), `ids` [n, H, W] the object that this
    ray meets (0 where nothing is).
    """

    intensity: NDArray[np.float32]
    depth: NDArray[np.float32]
    ids: NDArray[np.int8]


class View(Protocol):
    """One camera before one scene; instants are seconds on the rig clock."""

    def light(self, instants_s: Floats) -> NDArray[np.float32]:
        """Return the linear light at `instants_s` [n], in spikes per tick [n, H, W]."""
        ...

    def frames(self, instants_s: Floats) -> Frames:
        """Return light, depth and objects at `instants_s` [n]."""
        ...


class Visible(Protocol):
    """Things that a camera can be put before.

    `white` is the light that is shown as white, in spikes per tick.
    """

    @property
    def white(self) -> float:
        """The light that is shown as white."""
        ...

    def view(self, camera: Camera, samples: int, threads: int = 0) -> View:
        """Return what `camera` (pose in the rig frame) sees by samples x samples rays a pixel, or more.

        More may be where nothing moves. `threads` 0 takes every core. What it costs to prepare is paid at once.
        """
        ...


class Scenery(Visible, Protocol):
    """Things before a rig, in its frame, whichever renderer draws them.

    `center` is the point the scene happens around.
    """

    @property
    def name(self) -> str:
        """The name in the catalog."""
        ...

    @property
    def seed(self) -> int:
        """The seed that the scene was built with."""
        ...

    @property
    def center(self) -> Vector:
        """The point the scene happens around, in metres."""
        ...

    @property
    def object_ids(self) -> Mapping[str, int]:
        """The object id of each body by name."""
        ...

    @property
    def movers(self) -> Mapping[str, int]:
        """The object ids of the bodies that move, by name."""
        ...

    def render(self, camera: Camera, instants_s: Floats, samples: int = 4) -> Frames:
        """Return the frames that `camera` sees at `instants_s` [n]."""
        ...

    def prepare(self, cameras: Sequence[Camera], last_s: float, progress: Progress) -> None:
        """Make ready what views of the cameras will show until `last_s` on the rig clock, where that takes long."""
        ...

    def lit(self, factor: float) -> Self:
        """Return the same scene in `factor` times its light."""
        ...

    def since(self, begins_s: float) -> Self:
        """Return the scene as it is where it has been going on for `begins_s` at the instant 0."""
        ...

    def description(self) -> dict[str, Any]:
        """Return what `truth/scene.json` says of the scene beside its recording."""
        ...
