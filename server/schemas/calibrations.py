"""Calibrations of rigs: asked for, kept by version, and chosen."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field, model_validator

from server.schemas.job_types import BoardSpec, EntryId, JobBase
from server.schemas.progress import Items, Request

MOST_TOML = 64_000  # characters; nine cameras take 3,000


class CalibrationRequest(JobBase):
    """A calibration of a rig: from a `capture`, from `ticks` that are recorded first, or of pixels from `flat`, `dark`.

    A `board` gives lenses and poses; without one they come from whatever the cameras see. `apply`: make it current.
    """

    capture: EntryId | None = None
    ticks: Annotated[int | None, Field(ge=1, le=1_000_000)] = None
    flat: EntryId | None = None
    dark: EntryId | None = None
    board: BoardSpec | None = None
    apply: bool = True

    @model_validator(mode="after")
    def _one_way(self) -> CalibrationRequest:
        if (self.flat is None) != (self.dark is None):
            raise ValueError("found one of flat and dark, expected both or neither")
        ways = [way for way in (self.capture, self.ticks, self.flat) if way is not None]
        if len(ways) != 1:
            raise ValueError(f"found {len(ways)} of capture, ticks, and flat with dark, expected one")
        if self.flat is not None and self.board is not None:
            raise ValueError("found a board for pixels, expected it with capture or ticks")
        return self


class RigCheckRequest(JobBase):
    """A comparison of the current calibration with what a capture saw."""

    capture: EntryId


class CalibrationChoice(Request):
    """The calibration to use: an older `version` (0: the rig as it was drawn), or the text of a RIG.toml."""

    version: Annotated[int | None, Field(ge=0, le=2**31 - 1)] = None
    toml: Annotated[str | None, Field(min_length=1, max_length=MOST_TOML)] = None

    @model_validator(mode="after")
    def _one(self) -> CalibrationChoice:
        if (self.version is None) == (self.toml is None):
            raise ValueError("found neither or both of version and toml, expected one of them")
        return self


class CameraFindings(BaseModel):
    """The quality of one camera: RMS residual, and one standard deviation of its turn, place and focal length."""

    points: int
    residual_px: float
    rotation_deg_sd: float
    center_m_sd: float
    focal_percent_sd: float


class CalibrationInfo(BaseModel):
    """A version of a rig's calibration; 0 is the rig as it was drawn, which nobody stored: `created` is None."""

    rig: str
    version: int
    created: str | None
    source: Literal["nominal", "natural", "board", "pixels", "uploaded"]
    job: str | None
    poses: str
    sha256: str


class Calibrations(Items[CalibrationInfo]):
    """The calibrations of a rig, newest first, without the nominal one."""


class Calibration(CalibrationInfo):
    """A calibration and how good it is; `report` is the whole account of how it was found.

    `cameras` is empty where no poses were found; `picture` says whether there is one of the residuals.
    """

    residual_px: float | None
    rotation_sd_deg: float | None
    cameras: dict[str, CameraFindings]
    report: dict[str, object]
    picture: bool


class CurrentCalibration(Calibration):
    """The calibration in use; `revision` counts every change and stands in the ETag."""

    revision: int
