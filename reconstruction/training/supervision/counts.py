"""Compares rendered light with spike counts over random windows, by four measures of the difference."""

from __future__ import annotations

from typing import TYPE_CHECKING

from reconstruction.training.term import Supervision

if TYPE_CHECKING:
    from reconstruction.methods.definition import SpikeSampling
    from reconstruction.training.image_term import ImageTerm
    from reconstruction.training.spike_term import SpikeTerm


def absolute_term(image: ImageTerm, sampling: SpikeSampling) -> SpikeTerm:
    """Return the term of the mean absolute difference of rates."""
    from reconstruction.losses.counts import absolute_loss
    from reconstruction.training.spike_term import SpikeTerm

    return SpikeTerm(image, absolute_loss, sampling)


def square_term(image: ImageTerm, sampling: SpikeSampling) -> SpikeTerm:
    """Return the term of the mean squared difference of rates."""
    from reconstruction.losses.counts import square_loss
    from reconstruction.training.spike_term import SpikeTerm

    return SpikeTerm(image, square_loss, sampling)


def count_term(image: ImageTerm, sampling: SpikeSampling) -> SpikeTerm:
    """Return the term that knows how noisy a count is."""
    from reconstruction.losses.counts import robust_loss
    from reconstruction.training.spike_term import SpikeTerm

    return SpikeTerm(image, robust_loss, sampling)


def cumulative_term(image: ImageTerm, sampling: SpikeSampling) -> SpikeTerm:
    """Return the term of running totals."""
    from reconstruction.training.spike_term import SpikeTerm

    return SpikeTerm(image, None, sampling)


L1 = Supervision("l1", absolute_term)
L2 = Supervision("l2", square_term)
COUNTS = Supervision("counts", count_term)
CUMULATIVE = Supervision("cumulative", cumulative_term)
