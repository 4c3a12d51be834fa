"""One case of the catalogue, and one row of the table it makes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from reconstruction.rendering.render import Backend

Observation = tuple[str, float]  # in words, and how far it is from what was expected


@dataclass(frozen=True)
class Case:
    """`observe` returns what a backend made of it; the case passes where the error is at most `tolerance`.

    `number` is the stress catalogue's. Cases that render nothing run once, as backend `none`.
    """

    number: int
    name: str
    expected: str
    tolerance: float
    observe: Callable[[Backend], Observation]
    renders: bool = True


@dataclass(frozen=True)
class Row:
    """The outcome of a case on a backend."""

    case: str
    backend: str
    expected: str
    observed: str
    error: float | None  # None where it is not a number
    verdict: Literal["pass", "fail"]


def row_of(case: Case, backend: Backend) -> Row:
    """Run a case on a backend; an exception is a failure, with its text."""
    name = f"{case.number} {case.name}"
    on = backend if case.renders else "none"
    try:
        observed, error = case.observe(backend)
    except Exception as error:  # noqa: BLE001 - whatever a backend throws is what it made of the case
        return Row(name, on, case.expected, f"{type(error).__name__}: {error}", None, "fail")
    verdict = "pass" if error <= case.tolerance else "fail"
    return Row(name, on, case.expected, observed, error if math.isfinite(error) else None, verdict)
