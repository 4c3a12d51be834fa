"""What a step of a training asks of a model, and the losses that `--supervision` names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from reconstruction.gaussians.dynamic import DynamicCloud
    from reconstruction.training.image_term import ImageTerm
    from reconstruction.training.view import TrainingView

M = TypeVar("M", contravariant=True)


class Term(Protocol[M]):
    """Draws instants of a view and compares what a model shows there with what was recorded."""

    def __call__(self, model: M, view: TrainingView, rng: np.random.Generator, /) -> Tensor:
        """Return the loss of one step, a scalar; `rng` draws the instants."""
        ...


@dataclass(frozen=True)
class SpikeSampling:
    """The spikes that a spike term looks at.

    `planes`: the shortest and the longest window. `size_px`: width and height of the part of a view (None: all of it).
    """

    planes: tuple[int, int] = (8, 33)
    size_px: tuple[int, int] | None = (160, 128)


@dataclass(frozen=True)
class Supervision:
    """A loss that the operator may choose by `name`, beside or in place of the comparison with images.

    `term` makes its term, given the term on images: None where there is no other. `refused` says why it cannot be
    chosen yet and `instead` what to choose; both are empty where it can.
    """

    name: str
    term: Callable[[ImageTerm, SpikeSampling], Term[DynamicCloud] | None]
    refused: str = ""
    instead: str = ""
