"""The service itself and its workers."""

from typing import Literal

from pydantic import BaseModel

from server.schemas.progress import Items


class Info(BaseModel):
    """The service's name, version and stages; `role` is that of the request's token, null where none is needed."""

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


class Workers(Items[WorkerInfo]):
    """The workers that are alive."""
