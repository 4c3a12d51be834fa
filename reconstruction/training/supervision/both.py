"""Compares counts and the variation of images in one step, each at instants of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from reconstruction.training.supervision.counts import count_term
from reconstruction.training.supervision.image_variation import image_variation_term
from reconstruction.training.term import Supervision, Term

if TYPE_CHECKING:
    from reconstruction.gaussians.dynamic import DynamicCloud
    from reconstruction.methods.definition import SpikeSampling
    from reconstruction.training.image_term import ImageTerm


def _both(image: ImageTerm, sampling: SpikeSampling) -> Term[DynamicCloud]:
    first, second = image_variation_term(image, sampling), count_term(image, sampling)
    return lambda cloud, view, rng: first(cloud, view, rng) + second(cloud, view, rng)


BOTH = Supervision("both", _both)
