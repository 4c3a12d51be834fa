"""The common parts of requests, of pages and of reports of progress."""

from typing import Any, Generic, Literal, TypeVar, get_args

from pydantic import BaseModel, ConfigDict

Status = Literal["queued", "running", "done", "failed", "cancelled"]
ACTIVE: tuple[Status, ...] = ("queued", "running")
ENDED: tuple[Status, ...] = tuple(status for status in get_args(Status) if status not in ACTIVE)
WITH_ERROR: tuple[Status, ...] = ("done", "failed")  # else an error is of an attempt before the one that is on its way
Item = TypeVar("Item")


class Request(BaseModel):
    """A request with an unknown member is refused; every kind of request shows an example of itself."""

    model_config = ConfigDict(extra="forbid")


def example(*shown: dict[str, Any]) -> ConfigDict:
    """Return the configuration of a request whose schema shows these examples."""
    return ConfigDict(json_schema_extra={"examples": list(shown)})


class Items(BaseModel, Generic[Item]):
    """A list, whole."""

    items: list[Item]


class Page(Items[Item], Generic[Item]):
    """A part of a list; `next` is the cursor of the next page."""

    next: str | None = None


class Preview(BaseModel):
    """The newest picture that a training has drawn of its scene; `at` is when it was drawn, in seconds since 1970.

    It is rendered as `camera` would see the scene, after `steps` steps of training. None of that camera's spikes are
    in it where it is held out.
    """

    camera: str
    steps: int
    at: float


class Progress(BaseModel):
    """The progress of a capture or job: `fraction` of the current `stage`, and the seconds each stage has taken.

    `warnings` are what a person should know before trusting the result. `bad_input`: the error is about what was asked
    for or recorded, so the same would fail again. `preview`: what `GET jobs/JID/preview` shows, once it shows anything.
    """

    stage: str | None = None
    fraction: float = 0.0
    message: str = ""
    seconds: dict[str, float] = {}
    error: str | None = None
    bad_input: bool = False
    warnings: list[str] = []
    preview: Preview | None = None


class StatusChange(BaseModel):
    """A new status of a capture or job, with the reason where it failed."""

    status: Status
    error: str | None = None


class Event(BaseModel):
    """Something that happened to a capture or job; `seq` grows, `at` is in seconds since 1970.

    `kind` is `status` (data: `status`, and `error` where it failed) or `progress` (data as of Progress).
    """

    seq: int
    entry: str
    at: float
    kind: Literal["status", "progress"]
    data: Progress | StatusChange
