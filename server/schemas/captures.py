"""Recordings, made or in the making."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, model_validator

from acquisition.devices.registers import EXPOSURES, THRESHOLDS
from server.schemas.progress import Page, Progress, Request, Status, example

NEVER_BEGUN = "stopped before it began, so nothing was kept"
# No control characters, no line ends, nothing that turns the direction of the text around it.
SHOWN = r"^[^\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ufeff]+$"
Name = Annotated[str, Field(min_length=1, max_length=80, pattern=SHOWN)]
# The same, of several lines.
Note = Annotated[
    str,
    Field(min_length=1, max_length=2000, pattern=SHOWN.replace("\\x00-\\x1f", "\\x00-\\x08\\x0b-\\x1f")),
]


class Labels(Request):
    """The words that people put to a capture or job; what is left out stays, and null takes it away."""

    model_config = example({"note": "the fan ran at half speed"}, {"name": "fan, second try", "note": None})

    name: Name | None = None
    note: Note | None = None


class CaptureRequest(Request):
    """A recording to make; its length in ticks, or until it is stopped.

    With `pre_trigger_ms` the last milliseconds are kept in memory until `save` is asked for. `threshold` (charge of a
    spike) and `exposure` (part of a tick that gathers light) are thousandths and stay in the cameras.
    """

    model_config = example({"ticks": 2000, "name": "fan, first try"}, {"until_stopped": True, "pre_trigger_ms": 50})

    ticks: Annotated[int | None, Field(ge=1, le=10_000_000)] = None
    until_stopped: bool = False
    pre_trigger_ms: Annotated[float | None, Field(gt=0, le=60_000, allow_inf_nan=False)] = None
    threshold: Annotated[int | None, Field(ge=THRESHOLDS[0], le=THRESHOLDS[1])] = None
    exposure: Annotated[int | None, Field(ge=EXPOSURES[0], le=EXPOSURES[1])] = None
    rejoin_s: Annotated[float | None, Field(ge=0, le=50, allow_inf_nan=False)] = None
    name: Name | None = None

    @model_validator(mode="after")
    def _one_length(self) -> CaptureRequest:
        if (self.ticks is None) != self.until_stopped:
            raise ValueError("found neither or both of ticks and until_stopped, expected one of them")
        return self


CameraKey = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,39}$")]
UploadRef = Annotated[str, Field(max_length=40)]


class OfRig(Request):
    """The cameras of a rig of this service, as it is calibrated now."""

    rig: Annotated[str, Field(max_length=64)]


class ImportRequest(Request):
    """A recording to make of uploads: one `.dat` a camera, by the cameras' ids or in row-major order.

    `cameras` is an upload too (a transforms.json or a RIG.toml) or a rig of this service; `size` is width and height
    where the cameras' file has none. The other options are those of `spike4dgs import`.
    """

    uploads: (
        Annotated[dict[CameraKey, UploadRef], Field(min_length=1, max_length=100)]
        | Annotated[list[UploadRef], Field(min_length=1, max_length=100)]
    )
    cameras: UploadRef | OfRig
    tick_rate_hz: Annotated[float, Field(gt=0, le=1e7, allow_inf_nan=False)]
    size: tuple[Annotated[int, Field(ge=1, le=9999)], Annotated[int, Field(ge=1, le=9999)]] | None = None
    format: Literal["vidar", "vidar416", "m1k40"] = "vidar"
    bit_order: Literal["lsb", "msb"] | None = None
    row_order: Literal["bottom", "top"] | None = None
    poses: Literal["calibrated", "nominal"] | None = None
    allow_partial: bool = False
    align: bool = False
    name: Name | None = None

    @model_validator(mode="after")
    def _free_orders(self) -> ImportRequest:
        if self.format == "m1k40" and (self.bit_order or self.row_order):
            raise ValueError("found a bit or row order for m1k40, expected none: the format fixes them")
        return self


class Capture(Progress):
    """A recording, made or in the making; `type` says whether it was recorded or imported.

    `partial_planes` are the planes that a recorder which failed has left and `finalise` can keep. `note` is a person's.
    """

    id: str
    type: str
    rig: str | None
    ticks: int | None
    pre_trigger_ms: float | None = None
    name: str | None
    note: str | None = None
    created: str
    status: Status
    partial_planes: int | None = None


class Captures(Page[Capture]):
    """Captures, newest first; `next` is the cursor of the next page."""


class GapInfo(BaseModel):
    """Planes that were lost, and where: in the camera, on its link, in memory or at the disk."""

    first_plane: int
    planes: int
    layer: str


class CameraFileInfo(BaseModel):
    """One camera's stream; `gaps` are the first of `gaps_total`, `partial_bytes` follow the last whole plane."""

    id: str
    width: int
    height: int
    planes: int
    first_tick: int
    bytes: int
    sha256: str | None
    drops: dict[str, int]
    gaps: list[GapInfo]
    gaps_total: int
    skew_s: float | None
    skew_sd_s: float | None
    partial_bytes: int
    device: dict[str, Any] | None


class Verified(BaseModel):
    """The newest job that checked every byte; `sound` is None until it is done."""

    job: str
    created: str
    status: Status
    sound: bool | None = None
    damages: list[dict[str, Any]] = []


class ManifestInfo(BaseModel):
    """The contents of a recording and what it lacks; `reason` says why it is incomplete."""

    capture: str
    tick_rate_hz: float
    trigger: str
    writer: str
    status: str
    reason: str | None
    direct_io: bool | None
    trigger_plane: int | None
    cameras: list[CameraFileInfo]
    verified: Verified | None
