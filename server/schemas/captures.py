"""Recordings, made or in the making."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator

from acquisition.devices.registers import EXPOSURES, THRESHOLDS
from server.schemas.progress import Progress, Request, Status

# No control characters, no line ends, nothing that turns the direction of the text around it.
SHOWN = r"^[^\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ufeff]+$"
Name = Annotated[str, Field(min_length=1, max_length=80, pattern=SHOWN)]


class CaptureRequest(Request):
    """A recording to make; its length in ticks, or until it is stopped.

    With `pre_trigger_ms` the last milliseconds are kept in memory until `save` is asked for. `threshold` (charge of a
    spike) and `exposure` (part of a tick that gathers light) are thousandths and stay in the cameras.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"ticks": 2000, "name": "fan, first try"}, {"until_stopped": True, "pre_trigger_ms": 50}]
        }
    )

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


class Capture(Progress):
    """A recording, made or in the making; `type` says whether it was recorded or imported."""

    id: str
    type: str
    rig: str | None
    ticks: int | None
    name: str | None
    created: str
    status: Status


class Captures(BaseModel):
    """Captures, newest first; `next` is the cursor of the next page."""

    items: list[Capture]
    next: str | None = None
