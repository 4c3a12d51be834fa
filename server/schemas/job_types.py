"""What may be asked of a job: what is done with a capture, or with what another job made."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Discriminator, Field, Tag, model_validator

from server.schemas.captures import Name
from server.schemas.progress import Request

Images = Literal["auto", "tfi", "tfp", "tfstp", "tvs", "slope", "adaptive", "spk2imgnet", "blindspot", "msdi"]
ImageMethod = Literal["tfi", "tfp", "tfstp", "tvs", "slope", "adaptive", "spk2imgnet", "blindspot", "msdi"]
Init = Literal["auto", "sweep", "natural", "sfm", "msdi"]
Model = Literal[
    "auto",
    "static",
    "linear",
    "cubic",
    "bases",
    "4dgs",
    "stg",
    "d3dgs",
    "spikegs",
    "dy-spikegs",
    "spikenerf",
    "dy-spikenerf",
]
Supervision = Literal["auto", "pixels", "l1", "l2", "image-variation", "variation", "counts", "cumulative", "both"]
Refine = Literal["auto", "on", "off"]
Stage = Literal["plan", "poses", "images", "points", "train", "report"]
ExportFormat = Literal["ply", "ply-sequence", "splat", "spz", "glb", "video", "depth", "colmap", "nerfstudio"]

CameraId = Annotated[str, Field(pattern=r"^cam\d\d$")]
EntryId = Annotated[str, Field(max_length=40)]
Planes = Annotated[str, Field(pattern=r"^\d{1,8}:\d{1,8}(:\d{1,8})?$")]
RigId = Annotated[str, Field(min_length=1, max_length=64)]
BoardSpec = Annotated[str, Field(pattern=r"^(charuco|apriltag):[A-Za-z0-9_.:x]{5,80}$")]


class JobBase(Request):
    """What every job may be given: a name, and a priority: the lower is done the earlier."""

    name: Name | None = None
    priority: Annotated[int, Field(ge=1, le=1000)] = 100


class OfCapture(JobBase):
    """A job that works on a capture."""

    capture: EntryId


class OfJob(JobBase):
    """A job that works on what a finished reconstruction left."""

    job: EntryId


class ReconstructRequest(OfCapture):
    """A reconstruction of a capture; what is not given is decided by the plan.

    `budget_s` bounds the wall seconds up to the last checkpoint, `steps` the training steps; give at most one.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"capture": "c20260101-120000-0a1b2c3d", "holdout": "cam11", "budget_s": 300},
                {"type": "reconstruct", "capture": "c20260101-120000-0a1b2c3d"},
            ]
        }
    )

    type: Literal["reconstruct"] = "reconstruct"
    model: Model = "auto"
    images: Images = "auto"
    init: Init = "auto"
    supervision: Supervision = "auto"
    refine: Refine = "auto"
    holdout: CameraId | None = None
    views: Annotated[list[CameraId] | None, Field(min_length=2, max_length=100)] = None
    tick_stride: Annotated[int | None, Field(ge=1, le=10_000)] = None
    budget_s: Annotated[float | None, Field(gt=0, le=7 * 24 * 3600, allow_inf_nan=False)] = None
    steps: Annotated[int | None, Field(ge=1, le=10_000_000)] = None
    seed: Annotated[int | None, Field(ge=0, lt=2**31)] = None

    @model_validator(mode="after")
    def _one_bound(self) -> ReconstructRequest:
        if self.budget_s is not None and self.steps is not None:
            raise ValueError("found both budget_s and steps, expected at most one")
        return self


class ImagesRequest(OfCapture):
    """Intensity images of every camera at the planes A:B:STEP."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"type": "images", "capture": "c20260101-120000-0a1b2c3d", "method": "tfi", "ticks": "0:400:20"}
            ]
        }
    )

    type: Literal["images"]
    method: ImageMethod
    ticks: Planes | None = None


class CalibrateRequest(OfCapture):
    """A calibration of the rig from a capture: from a board that is waved before it, or from whatever it sees.

    With `dark`, a capture without light, it is one of the pixels, and `capture` is one under even light. What is found
    becomes a version of the calibration of `rig`, if one is named, and the current one where it is to `apply`.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "type": "calibrate",
                    "capture": "c20260101-120000-0a1b2c3d",
                    "board": "charuco:6x4:100:67.5:DICT_4X4_50",
                }
            ]
        }
    )

    type: Literal["calibrate"]
    board: BoardSpec | None = None
    dark: EntryId | None = None
    rig: RigId | None = None
    apply: bool = False

    @model_validator(mode="after")
    def _one_kind(self) -> CalibrateRequest:
        if self.board is not None and self.dark is not None:
            raise ValueError("found both board and dark, expected at most one")
        if self.apply and self.rig is None:
            raise ValueError("found apply without a rig, expected the rig that is calibrated")
        return self


class CheckRigRequest(OfCapture):
    """Whether the calibration that a capture was recorded with, or the current one of `rig`, still fits it."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"type": "check-rig", "capture": "c20260101-120000-0a1b2c3d"}]}
    )

    type: Literal["check-rig"]
    rig: RigId | None = None


class VerifyRequest(OfCapture):
    """Whether every byte of a capture is as it was written."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"type": "verify", "capture": "c20260101-120000-0a1b2c3d"}]}
    )

    type: Literal["verify"]


class EvaluateRequest(OfJob):
    """Scores of a reconstruction on its held-out camera."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"type": "evaluate", "job": "j20260101-121500-4e5f6a7b"}]}
    )

    type: Literal["evaluate"]


class RenderRequest(OfJob):
    """Pictures and depth from other cameras; `cameras` is the upload of a transforms.json whose frames have a time."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"type": "render", "job": "j20260101-121500-4e5f6a7b", "cameras": "u20260101-120000-0a1b2c3d"}]
        }
    )

    type: Literal["render"]
    cameras: EntryId


class ExportRequest(OfJob):
    """A reconstruction in another program's format; `at_s` and `frames` are as of `spike4dgs export`."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"type": "export", "job": "j20260101-121500-4e5f6a7b", "format": "spz", "at_s": 0.01}]
        }
    )

    type: Literal["export"]
    format: ExportFormat
    at_s: Annotated[float | None, Field(ge=0, le=1e6, allow_inf_nan=False)] = None
    frames: Annotated[int | None, Field(ge=1, le=1000)] = None
    camera: CameraId | None = None


class PreflightRequest(JobBase):
    """Everything that would spoil a recording, looked at: cameras, links, clocks, and the disk for `disk_seconds`."""

    type: Literal["preflight"] = "preflight"
    disk_seconds: Annotated[float, Field(ge=0.1, le=30, allow_inf_nan=False)] = 2.0


class LookRequest(JobBase):
    """A picture of what a rig's cameras see now, made of so few planes that nothing is kept of them."""

    type: Literal["look"] = "look"
    ticks: Annotated[int, Field(ge=1, le=2000)] = 100


def _type_of(value: Any) -> str:
    found = value.get("type", "reconstruct") if isinstance(value, dict) else getattr(value, "type", None)
    return found if isinstance(found, str) else "reconstruct"


JobRequest = Annotated[
    Annotated[ReconstructRequest, Tag("reconstruct")]
    | Annotated[ImagesRequest, Tag("images")]
    | Annotated[CalibrateRequest, Tag("calibrate")]
    | Annotated[CheckRigRequest, Tag("check-rig")]
    | Annotated[VerifyRequest, Tag("verify")]
    | Annotated[EvaluateRequest, Tag("evaluate")]
    | Annotated[RenderRequest, Tag("render")]
    | Annotated[ExportRequest, Tag("export")],
    Discriminator(_type_of),
]
JOB_TYPES: dict[str, type[JobBase]] = {
    "reconstruct": ReconstructRequest,
    "images": ImagesRequest,
    "calibrate": CalibrateRequest,
    "check-rig": CheckRigRequest,
    "verify": VerifyRequest,
    "evaluate": EvaluateRequest,
    "render": RenderRequest,
    "export": ExportRequest,
}
RIG_JOB_TYPES: dict[str, type[JobBase]] = {"preflight": PreflightRequest, "look": LookRequest}
RigJobRequest = Annotated[PreflightRequest | LookRequest, Discriminator("type")]


class BatchRequest(Request):
    """Jobs to queue together: all of them or, where one is refused, none."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "jobs": [
                        {"type": "verify", "capture": "c20260101-120000-0a1b2c3d"},
                        {"capture": "c20260101-120000-0a1b2c3d", "steps": 500},
                    ]
                }
            ]
        }
    )

    jobs: Annotated[list[JobRequest], Field(min_length=1, max_length=1000)]


class PriorityRequest(Request):
    """A new priority of a queued job: the lower is done the earlier."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"priority": 10}]})

    priority: Annotated[int, Field(ge=1, le=1000)]


class RestartRequest(Request):
    """The stage from which on an ended reconstruction is done again."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"stage": "train"}]})

    stage: Stage
