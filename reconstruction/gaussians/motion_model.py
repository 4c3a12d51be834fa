"""The interface of all motion models.

Letters: M moving Gaussians. Time u is in clips, 0 at the clip's start and 1 at its end, so that one learning rate fits
clips of any length.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import ClassVar

from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.rendering.result import Instantaneous
from reconstruction.scene_model import Rate


class MotionModel(ABC):
    """The motion of M Gaussians. A subclass is a dataclass; its fields are the tensors that a checkpoint stores."""

    kind: ClassVar[str]  # the name in a checkpoint
    networks: ClassVar[bool] = False  # whether networks or grids move the Gaussians: large operations of torch
    rates: ClassVar[Mapping[str, Rate]]  # by tensor; training leaves a tensor without a rate as it is

    @abstractmethod
    def at(self, moving: GaussianCloud, u: float) -> Instantaneous:
        """Return the M Gaussians at u; differentiable in every stored tensor, finite for any finite u."""

    def tensors(self) -> Iterator[tuple[str, Tensor]]:
        """Yield every stored tensor with its name."""
        yield from vars(self).items()

    def span(self) -> tuple[float, float]:
        """Return the first and last u of the part of the clip that training looks at now."""
        return 0.0, 1.0

    def advance(self, moving: GaussianCloud, done: float) -> float:
        """Take note before a step that `done` (0 to 1) of the training is over; return how much of this stage is."""
        return done

    def penalty(self, moving: GaussianCloud) -> Tensor | None:
        """Return the scalar that the model's own regulariser adds to the loss, or None where it has none."""
        return None
