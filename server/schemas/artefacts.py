"""What jobs have made."""

from __future__ import annotations

from pydantic import BaseModel


class Artefact(BaseModel):
    """A file a job has made; its size in bytes."""

    name: str
    media_type: str
    bytes: int
    sha256: str


class Artefacts(BaseModel):
    """What a job has made so far."""

    items: list[Artefact]
