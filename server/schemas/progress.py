"""How far work is."""

from typing import Literal

from pydantic import BaseModel, ConfigDict

Status = Literal["queued", "running", "done", "failed", "cancelled"]
ACTIVE: tuple[Status, ...] = ("queued", "running")


class Request(BaseModel):
    """A request with an unknown member is refused; every kind of request shows an example of itself."""

    model_config = ConfigDict(extra="forbid")


class Progress(BaseModel):
    """How far a capture or job is: `fraction` of the current `stage`, and the seconds each stage has taken."""

    stage: str | None = None
    fraction: float = 0.0
    message: str = ""
    seconds: dict[str, float] = {}
    error: str | None = None


class Event(BaseModel):
    """Something that happened to a capture or job; `seq` grows, `at` is in seconds since 1970.

    `kind` is `status` (data: `status`, and `error` where it failed) or `progress` (data as of Progress).
    """

    seq: int
    entry: str
    at: float
    kind: str
    data: dict[str, object]
