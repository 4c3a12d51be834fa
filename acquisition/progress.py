"""How long work tells its caller how far it is."""

from typing import Protocol


class Progress(Protocol):
    """Called with the fraction done in [0, 1] and a short message; must return at once."""

    def __call__(self, fraction: float, message: str, /) -> None:
        """Report."""
        ...


def silent(fraction: float, message: str) -> None:
    """Report nothing."""
