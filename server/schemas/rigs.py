"""Rigs."""

from pydantic import BaseModel


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


class Rigs(BaseModel):
    """The rigs of this service."""

    items: list[RigInfo]
