"""One camera of a training: what it sees of a model, and what it should see."""

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.images.composite import CompositeSource
from reconstruction.rendering.result import Instantaneous
from rigs.camera import Camera


@dataclass(frozen=True, eq=False)
class TrainingView:
    """A camera and the images it should see.

    `corrected`: the cloud at an instant (s) as its refined pose, gain and lag show it (None: they stand as they are).
    `inverse_depth` [H, W]: of the pixels whose depth is known before the training, 1/m, else 0. `empty` [H, W]: 1 where
    nothing is, else 0; None where something is everywhere.
    """

    camera: Camera
    source: CompositeSource
    corrected: Callable[[DynamicCloud, float], Instantaneous] | None = None
    inverse_depth: Tensor | None = None
    empty: Tensor | None = None

    def seen(self, cloud: DynamicCloud, instant_s: float) -> Instantaneous:
        """Return the Gaussians to render for this camera at an instant (s, rig clock)."""
        return self.corrected(cloud, instant_s) if self.corrected else cloud.at(instant_s)
