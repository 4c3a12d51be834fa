"""Compares rendered light with spike counts over random windows, by four measures of the difference."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from reconstruction.training.term import Supervision

if TYPE_CHECKING:
    from reconstruction.methods.definition import SpikeSampling
    from reconstruction.training.image_term import ImageTerm
    from reconstruction.training.spike_term import SpikeTerm


def count_term(image: ImageTerm, sampling: SpikeSampling, name: str = "counts") -> SpikeTerm:
    """Return the term of the supervision `name`; that of `counts` knows how noisy a count is."""
    from reconstruction.losses.counts import absolute_loss, robust_loss, square_loss
    from reconstruction.training.spike_term import SpikeTerm

    losses = {"l1": absolute_loss, "l2": square_loss, "counts": robust_loss, "cumulative": None}  # None: running totals
    return SpikeTerm(image, losses[name], sampling)


L1, L2, COUNTS, CUMULATIVE = (
    Supervision(name, partial(count_term, name=name)) for name in ("l1", "l2", "counts", "cumulative")
)
