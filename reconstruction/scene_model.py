"""The protocol of a scene that is trained, rendered and scored: Gaussians or a radiance field."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sized
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.errors import ReconstructionError
from rigs.camera import Camera
from rigs.clock import RigClock


@dataclass(frozen=True)
class TimeSpan:
    """The part of the rig clock that a model covers, in seconds; raises ReconstructionError unless it is positive."""

    first_s: float
    last_s: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.first_s) and self.last_s > self.first_s):
            raise ReconstructionError(f"found a clip from {self.first_s} to {self.last_s} s", "a positive length")

    @classmethod
    def of_planes(cls, clock: RigClock, first: int, last: int) -> TimeSpan:
        """Return the time that planes [first, last) on `clock` are exposed."""
        return cls(clock.begins_s(first), clock.begins_s(last))

    @property
    def middle_s(self) -> float:
        """Return the middle, in seconds on the rig clock."""
        return (self.first_s + self.last_s) / 2

    def fraction(self, instant_s: float) -> float:
        """Return `instant_s` (seconds on the rig clock) in clips: 0 at the start of the span, 1 at its end."""
        return (instant_s - self.first_s) / (self.last_s - self.first_s)

    def instant_s(self, fraction: float) -> float:
        """Return the instant, in seconds on the rig clock, that lies `fraction` clips after the start."""
        return self.first_s + fraction * (self.last_s - self.first_s)


@dataclass(frozen=True, eq=False)
class View:
    """A finished picture: linear intensity [H, W] in spikes per tick, and depth [H, W] in m along the camera's z.

    The depth of a model is the median one: where half of the light is taken, NaN where less than half ever is.
    """

    intensity: NDArray[np.float32]
    depth: NDArray[np.float32]


class Rate(NamedTuple):
    """The learning rate at which Adam starts on one kind of tensor.

    `unit`: what the rate is multiplied by. "scene" is the mean distance from the cameras to the points, for tensors
    of lengths; "light" is the scene's brightness, for tensors of light. `deforms`: whether the tensor belongs to a
    deformation, which is not learnt before the canonical scene is.
    """

    start: float
    unit: Literal["none", "scene", "light"] = "none"
    deforms: bool = False


class SceneModel(Protocol):
    """A scene over one time span. Names of tensors are `part.kind`, such as `still.means`."""

    unit: ClassVar[str]  # what the model is made of, in the plural
    clip: TimeSpan
    light: Tensor  # [T] gain of each of the clip's planes, or [1] where the light is steady

    @property
    def networks(self) -> bool:
        """Tell whether a step has large operations of torch, for several threads; else our kernels have them all."""
        ...

    @property
    def still(self) -> Sized:
        """The elements that stand still."""
        ...

    @property
    def moving(self) -> Sized:
        """The elements that move."""
        ...

    def __len__(self) -> int: ...

    def tensors(self) -> Iterator[tuple[str, Tensor]]:
        """Yield every stored tensor with its name, always in the same order."""
        ...

    def rates(self) -> Mapping[str, Rate]:
        """Return the learning rates by tensor name; training leaves a tensor without one as it is."""
        ...

    def advance(self, done: float) -> float:
        """Take note before a step that `done` (0 to 1) of the training is over; return how much of this stage is."""
        ...

    def penalty(self) -> Tensor | None:
        """Return the scalar that the model's own regulariser adds to the loss, or None where it has none."""
        ...

    def opacity(self) -> Tensor:
        """Return the largest share of the light that each element takes, [N + M] in 0 to 1, without gradients."""
        ...

    def positions(self, instant_s: float) -> Tensor:
        """Return where the elements are [N + M, 3], in m in the rig frame, the still ones first."""
        ...

    def movers(self, instant_s: float) -> tuple[Tensor, Tensor]:
        """Return positions [K, 3] in m and opacities [K] of the moving parts; K may be 0."""
        ...

    def look(self, camera: Camera, instant_s: float) -> View:
        """Return what `camera` sees through its lens at an instant; raises RigError where no pinhole covers it."""
        ...

    def to(self, kind: torch.dtype | torch.device) -> Self:
        """Return the same model in another float type, or on another device.

        Raises ReconstructionError where the model has no such form.
        """
        ...

    def state(self) -> dict[str, Any]:
        """Return tensors, numbers and names for a checkpoint; `training.checkpoint.model_from_state` is the inverse."""
        ...


def gain_at(light: Tensor, u: float) -> float:
    """Return the light's gain at `u`, in clips, of the gains [T] of a clip's planes; beyond the ends as at them."""
    return float(light[min(max(int(u * len(light)), 0), len(light) - 1)])
