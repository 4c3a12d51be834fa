"""Jobs, done or to be done, and what they have made."""

from typing import Literal

from pydantic import BaseModel

from server.schemas.job_types import JobRequest, RigJobRequest
from server.schemas.progress import Items, Page, Progress, Status

Order = Literal["newest", "work"]


class Job(Progress):
    """A job, done or to be done; `rig` is the one it, or the capture it works on, was made with. `note` is a person's.

    `position` is the place of a queued job in its queue, from 1 on. `expected_begin` and `expected_end` are estimated
    from the budget, the share that is done, earlier jobs of the type and the workers that are alive. They are null
    where these do not tell, and in the answer to a batch, which is queued as it is given. `resumable`: it failed or
    was cancelled, and resuming may help. A job whose input was refused (`bad_input`) would be refused again: queue one
    with other options.
    """

    id: str
    type: str
    created: str
    status: Status
    priority: int
    name: str | None
    request: JobRequest | RigJobRequest
    rig: str | None = None
    note: str | None = None
    position: int | None = None
    expected_begin: str | None = None
    expected_end: str | None = None
    resumable: bool = False


class Jobs(Page[Job]):
    """Jobs, newest first; `next` is the cursor of the next page."""


class Step(BaseModel):
    """A stage of a job: whether it is finished, and the seconds it has taken in all attempts."""

    stage: str
    status: Literal["waiting", "running", "done", "failed"]
    seconds: float | None


class Steps(Items[Step]):
    """The stages of a job, in order."""


class Artefact(BaseModel):
    """A file a job has made; its size in bytes."""

    name: str
    media_type: str
    bytes: int
    sha256: str


class CameraPictures(BaseModel):
    """Pictures that `cameras` of `capture` took, made of spikes by `method`: estimates, not the truth.

    Each is of one of `planes` planes, `tick_rate_hz` a second; `white` (spikes per tick) is shown white, as in renders.
    """

    method: str
    capture: str
    cameras: list[str]
    planes: int
    tick_rate_hz: float
    white: float


class Artefacts(Items[Artefact]):
    """The files a job has made so far."""
