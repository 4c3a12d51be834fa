"""Rigs."""

from pydantic import BaseModel

from server.schemas.progress import Items, Status


class CameraInfo(BaseModel):
    """A camera's id and size in pixels."""

    id: str
    width: int
    height: int


class RigInfo(BaseModel):
    """A rig; `calibration` is the version in use, with its `poses`; `busy` is the capture or job that uses it."""

    id: str
    name: str
    tick_rate_hz: float
    poses: str
    calibration: int
    devices: str
    cameras: list[CameraInfo]
    busy: str | None


class Rigs(Items[RigInfo]):
    """The rigs of this service."""


class Room(BaseModel):
    """The room left on the disk: `seconds` of recording with all cameras."""

    free_bytes: int
    bytes_per_s: float
    seconds: float


class CalibrationInUse(BaseModel):
    """The calibration that captures are made with."""

    version: int
    source: str
    created: str


class RigCheck(BaseModel):
    """One thing a preflight looked at; `passed` is None where it does not apply."""

    name: str
    passed: bool | None
    found: str
    expected: str
    change: str


class CameraState(BaseModel):
    """A camera as the last preflight found it; values that it could not measure are None.

    `skew_us` is the distance of its first plane from the zero of its clock; `fault` says why it is not connected.
    """

    id: str
    connected: bool | None = None
    serial: str | None = None
    firmware: int | None = None
    fault: str | None = None
    port: str | None = None
    link_mbit_s: float | None = None
    link_errors: int | None = None
    link_recoveries: int | None = None
    skew_us: float | None = None
    sync_pulses: int | None = None


class Preflight(BaseModel):
    """The newest preflight that ended with an answer, `age_s` old."""

    job: str
    created: str
    age_s: float
    ready: bool
    checks: list[RigCheck]


class Work(BaseModel):
    """The capture or job that uses the rig, and how far it is; `message` has the cameras' health and buffers."""

    id: str
    type: str
    status: Status
    fraction: float
    message: str


class Look(BaseModel):
    """The newest picture from the cameras, `age_s` old."""

    age_s: float
    etag: str


class RigStatus(BaseModel):
    """The state of a rig: `worker` says whether one is alive that reaches its cameras."""

    rig: str
    worker: bool
    busy: Work | None
    disk: Room
    calibration: CalibrationInUse | None
    preflight: Preflight | None
    cameras: list[CameraState]
    look: Look | None
