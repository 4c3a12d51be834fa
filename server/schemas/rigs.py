"""Rigs."""

from pydantic import BaseModel


class CameraInfo(BaseModel):
    """A camera's id and size in pixels."""

    id: str
    width: int
    height: int


class RigInfo(BaseModel):
    """A rig; `calibration` is the version in use, `poses` are its, `busy` is the capture it is recording, if any."""

    id: str
    name: str
    tick_rate_hz: float
    poses: str
    calibration: int
    devices: str
    cameras: list[CameraInfo]
    busy: str | None


class Rigs(BaseModel):
    """The rigs of this service."""

    items: list[RigInfo]
