"""Defines a case of the catalogue, and the row of the table that it makes."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

from rigs.errors import Spike4dgsError

STEEPER = 10.0  # tolerance of gradients over that of values


class Observation(NamedTuple):
    """One observation: words, and the errors of values and of gradients."""

    said: str
    error: float
    gradient: float | None = None


@dataclass(frozen=True)
class Case:
    """A situation, and the function that observes it on each of `on()`: renderers, image methods, motion models.

    A case passes where the error is at most `tolerance`, and that of gradients at most STEEPER times as much. `number`
    is its number in the stress catalogue; fields and runs on the stiff scenes have none.
    """

    number: int | None
    name: str
    expected: str
    tolerance: float
    observe: Callable[[str], Observation]
    on: Callable[[], tuple[str, ...]] = lambda: ("none",)


@dataclass(frozen=True)
class Row:
    """The outcome of a case; `error` and `gradient` are None where there is none, or where it is not finite."""

    case: str
    backend: str
    expected: str
    observed: str
    error: float | None
    gradient: float | None
    verdict: Literal["pass", "fail"]


def refusal(work: Callable[[], object]) -> Spike4dgsError | None:
    """Return the error that `work` is refused with; None where it is not."""
    try:
        work()
    except Spike4dgsError as error:
        return error
    return None


def row_of(case: Case, backend: str) -> Row:
    """Run a case on one of `case.on()`; an exception is a failure with its text."""
    name = case.name if case.number is None else f"{case.number} {case.name}"
    try:
        said, error, gradient = case.observe(backend)
    except Exception as error:  # noqa: BLE001 - any exception is an outcome of the case
        return Row(name, backend, case.expected, f"{type(error).__name__}: {error}", None, None, "fail")
    good = error <= case.tolerance and (gradient is None or gradient <= STEEPER * case.tolerance)
    return Row(name, backend, case.expected, said, _finite(error), _finite(gradient), "pass" if good else "fail")


def _finite(number: float | None) -> float | None:
    return number if number is not None and math.isfinite(number) else None
