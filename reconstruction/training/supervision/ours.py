"""The supervisions of this project: images alone, how they change over time, and spike counts by four measures.

`variation` is SPSS, the loss of Spike4DGS, as we read it: renders become spikes, and how their counts change is
compared with the recorded ones. `image-variation` compares the same statistics of images.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from reconstruction.training.term import Supervision, Term

if TYPE_CHECKING:
    from reconstruction.gaussians.dynamic import DynamicCloud
    from reconstruction.methods.definition import SpikeSampling
    from reconstruction.training.image_term import ImageTerm


def _count_term(image: ImageTerm, sampling: SpikeSampling, name: str) -> Term[DynamicCloud]:
    """Return the term that compares counts over random windows; that of `counts` knows how noisy a count is."""
    from reconstruction.losses.counts import absolute_loss, robust_loss, square_loss
    from reconstruction.training.spike_term import SpikeTerm

    losses = {"l1": absolute_loss, "l2": square_loss, "counts": robust_loss, "cumulative": None}  # None: running totals
    return SpikeTerm(image, losses[name], sampling)


def _image_variation_term(image: ImageTerm, _: SpikeSampling) -> Term[DynamicCloud]:
    from reconstruction.training.image_term import ImageVariationTerm

    return ImageVariationTerm(image)


def _spike_variation_term(image: ImageTerm, sampling: SpikeSampling) -> Term[DynamicCloud]:
    from reconstruction.training.spike_variation_term import SpikeVariationTerm

    return SpikeVariationTerm(image, sampling)


def _both_terms(image: ImageTerm, sampling: SpikeSampling) -> Term[DynamicCloud]:
    """Return the sum of two terms, each at instants of its own."""
    first, second = _image_variation_term(image, sampling), _count_term(image, sampling, "counts")
    return lambda cloud, view, draws: first(cloud, view, draws) + second(cloud, view, draws)


BOTH = Supervision("both", _both_terms)
L1, L2, COUNTS, CUMULATIVE = (
    Supervision(name, partial(_count_term, name=name)) for name in ("l1", "l2", "counts", "cumulative")
)
IMAGE_VARIATION = Supervision("image-variation", _image_variation_term)
PIXELS = Supervision("pixels", lambda image, sampling: None)
VARIATION = Supervision("variation", _spike_variation_term)
