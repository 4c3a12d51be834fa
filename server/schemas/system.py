"""What the service is and how it is."""

from typing import Literal

from pydantic import BaseModel


class Info(BaseModel):
    """What this service is; `role` is what the request's token allows, null where none is needed."""

    name: str
    version: str
    stages: tuple[str, ...]
    role: Literal["viewer", "operator"] | None = None


class Check(BaseModel):
    """One condition of being ready."""

    ok: bool
    found: str


class WorkerInfo(BaseModel):
    """A worker that is alive; `age_s` since its last beat."""

    id: str
    host: str
    queues: list[str]
    age_s: float


class Workers(BaseModel):
    """The workers that are alive."""

    items: list[WorkerInfo]
