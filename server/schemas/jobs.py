"""Jobs, done or to be done, and what they have made."""

from typing import Literal

from pydantic import BaseModel

from server.schemas.job_types import JobRequest, RigJobRequest
from server.schemas.progress import Items, Page, Progress, Status


class Job(Progress):
    """A job, done or to be done; `rig` is the one it, or the capture it works on, was made with."""

    id: str
    type: str
    created: str
    status: Status
    priority: int
    name: str | None
    request: JobRequest | RigJobRequest
    rig: str | None = None


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


class Artefacts(Items[Artefact]):
    """The files a job has made so far."""
