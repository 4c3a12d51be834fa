"""Compares counts and the variation of images in one step, each at instants of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from reconstruction.training.supervision.counts import count_term
from reconstruction.training.supervision.image_variation import image_variation_term
from reconstruction.training.term import Supervision, Term

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from reconstruction.gaussians.dynamic import DynamicCloud
    from reconstruction.methods.definition import SpikeSampling
    from reconstruction.training.image_term import ImageTerm
    from reconstruction.training.view import TrainingView


@dataclass(frozen=True)
class BothTerms:
    """Adds the losses of two terms."""

    first: Term[DynamicCloud]
    second: Term[DynamicCloud]

    def __call__(self, cloud: DynamicCloud, view: TrainingView, rng: np.random.Generator) -> Tensor:
        """Return the sum of both losses."""
        return self.first(cloud, view, rng) + self.second(cloud, view, rng)


def _both(image: ImageTerm, sampling: SpikeSampling) -> BothTerms:
    return BothTerms(image_variation_term(image, sampling), count_term(image, sampling))


BOTH = Supervision("both", _both)
