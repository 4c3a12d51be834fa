"""Lets long work tell its caller how far it is."""

from collections.abc import Callable

Progress = Callable[[float, str], None]  # takes the fraction done in [0, 1] and a short message; returns at once


def silent(fraction: float, message: str) -> None:
    """Report nothing."""


def part(progress: Progress, first: float, last: float) -> Progress:
    """Return a progress whose fractions 0 to 1 are reported to `progress` as `first` to `last`."""
    return lambda fraction, message: progress(first + (last - first) * fraction, message)
