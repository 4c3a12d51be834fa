"""What travels over REST."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Status = Literal["queued", "running", "done", "failed", "cancelled"]
Images = Literal["auto", "tfi", "tfp"]
Init = Literal["auto", "sweep", "natural", "sfm", "msdi"]
Model = Literal["auto", "static", "linear"]
Supervision = Literal["auto", "pixels", "variation"]


class Info(BaseModel):
    """What this service is."""

    name: str
    version: str
    stages: tuple[str, ...]


class Check(BaseModel):
    """One condition of being ready."""

    ok: bool
    found: str


class CameraInfo(BaseModel):
    """A camera's id and size in pixels."""

    id: str
    width: int
    height: int


class RigInfo(BaseModel):
    """A rig; `busy` is the capture it is recording, if any."""

    id: str
    name: str
    tick_rate_hz: float
    poses: str
    devices: str
    cameras: list[CameraInfo]
    busy: str | None


class Request(BaseModel):
    """A request with an unknown member is refused."""

    model_config = ConfigDict(extra="forbid")


class CaptureRequest(Request):
    """A recording to make: its length in ticks and a name for people."""

    ticks: Annotated[int, Field(ge=1, le=10_000_000)]
    name: Annotated[str | None, Field(max_length=80, pattern=r"^[^\x00-\x1f\x7f]+$")] = None


class JobRequest(Request):
    """A reconstruction of a capture; what is not given is decided by the plan.

    `budget_s` bounds the wall seconds up to the last checkpoint, `steps` the training steps; give at most one.
    """

    capture: str
    model: Model = "auto"
    images: Images = "auto"
    init: Init = "auto"
    supervision: Supervision = "auto"
    holdout: Annotated[str | None, Field(pattern=r"^cam\d\d$")] = None
    budget_s: Annotated[float | None, Field(gt=0, le=7 * 24 * 3600)] = None
    steps: Annotated[int | None, Field(ge=1, le=10_000_000)] = None
    seed: Annotated[int | None, Field(ge=0, lt=2**31)] = None

    @model_validator(mode="after")
    def _one_bound(self) -> JobRequest:
        if self.budget_s is not None and self.steps is not None:
            raise ValueError("found both budget_s and steps, expected at most one")
        return self


class Progress(BaseModel):
    """How far a capture or job is: `fraction` of the current `stage`, and the seconds each stage has taken."""

    stage: str | None = None
    fraction: float = 0.0
    message: str = ""
    seconds: dict[str, float] = {}
    error: str | None = None


class Capture(Progress):
    """A recording, made or in the making."""

    id: str
    rig: str
    ticks: int
    name: str | None
    created: str
    status: Status


class Job(Progress):
    """A reconstruction, made or in the making."""

    id: str
    created: str
    status: Status
    request: JobRequest


class Artefact(BaseModel):
    """A file a job has made; its size in bytes."""

    name: str
    media_type: str
    bytes: int


class Rigs(BaseModel):
    """The rigs of this service."""

    items: list[RigInfo]


class Captures(BaseModel):
    """Captures, newest first."""

    items: list[Capture]


class Jobs(BaseModel):
    """Jobs, newest first."""

    items: list[Job]


class Artefacts(BaseModel):
    """What a job has made so far."""

    items: list[Artefact]
