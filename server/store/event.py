"""One thing that happened to an entry."""

from dataclasses import dataclass
from typing import Any, Literal

EventKind = Literal["status", "progress"]


@dataclass(frozen=True)
class Event:
    """One thing that happened to an entry, at a time in seconds since 1970."""

    seq: int
    entry: str
    at: float
    kind: EventKind
    data: dict[str, Any]
