"""The loss of one training step, and the losses that `--supervision` names."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeVar

from acquisition.members import members

if TYPE_CHECKING:
    from torch import Tensor

    from reconstruction.gaussians.dynamic import DynamicCloud
    from reconstruction.methods.definition import SpikeSampling
    from reconstruction.training.draws import Draws
    from reconstruction.training.image_term import ImageTerm
    from reconstruction.training.view import TrainingView

M = TypeVar("M", contravariant=True)


class Term(Protocol[M]):
    """Draws instants of a view and compares what a model shows there with what was recorded."""

    def __call__(self, model: M, view: TrainingView, draws: Draws, /) -> Tensor:
        """Return the loss of one step, a scalar, at the instants that `draws` gives."""
        ...


@dataclass(frozen=True)
class Supervision:
    """A loss that the operator may choose by `name`, beside or in place of the comparison with images.

    `term` makes its term, given the term on images: None where there is no other.
    """

    name: str
    term: Callable[[ImageTerm, SpikeSampling], Term[DynamicCloud] | None]


@functools.cache
def supervisions() -> Mapping[str, Supervision]:
    """Return every supervision by its name."""
    return members("reconstruction.training.supervision", Supervision)
