"""The types of jobs: each works on a capture, or on the results of another job."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, Discriminator, Field, GetCoreSchemaHandler, Tag, model_validator
from pydantic_core import CoreSchema, core_schema

from reconstruction.export.catalogue import FORMATS
from reconstruction.images.catalogue import GIVEN
from reconstruction.run.configuration import CHOICES, RANDOM, STAGES
from reconstruction.run.spans import LEAST
from server.schemas.captures import CameraKey, Name
from server.schemas.progress import Request, example

EntryId = Annotated[str, Field(max_length=40)]


def _some_planes(text: str) -> str:
    first, end, step = (*map(int, text.split(":")), 1)[:3]
    if first >= end or step < 1:
        raise ValueError(f"found {text}, expected A:B or A:B:STEP with A < B and STEP > 0")
    return text


Planes = Annotated[str, Field(pattern=r"^\d{1,8}:\d{1,8}(:\d{1,8})?$"), AfterValidator(_some_planes)]
RigId = Annotated[str, Field(min_length=1, max_length=64)]
_CAPTURE = {"capture": "c20260101-120000-0a1b2c3d"}
_JOB = {"job": "j20260101-121500-4e5f6a7b"}
Tick = Annotated[int, Field(ge=-(2**53), le=2**53)]
BoardSpec = Annotated[str, Field(pattern=r"^(charuco|apriltag):[A-Za-z0-9_.:x]{5,80}$")]


# These read files of the user or are for benchmarks alone.
_COMMAND_LINE_ONLY = (*GIVEN, "dust3r", RANDOM)


@dataclass(frozen=True)
class OneOf:
    """Makes pydantic accept one of `names` and list them in the schema, as it does for a Literal."""

    names: Sequence[str]

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of a Literal of the names."""
        return core_schema.literal_schema(list(self.names))


def _choice(field: str) -> OneOf:
    return OneOf([name for name in CHOICES[field] if name not in _COMMAND_LINE_ONLY])


class JobBase(Request):
    """The options of every job: a name, and a priority, of which the lower is done earlier."""

    name: Name | None = None
    priority: Annotated[int, Field(ge=1, le=1000)] = 100


class OfCapture(JobBase):
    """A job that works on a capture."""

    capture: EntryId


class OfJob(JobBase):
    """A job that works on the results of a finished reconstruction."""

    job: EntryId


def _some_ticks(request: ReconstructRequest | ExportRequest) -> Any:
    first, last = request.from_tick, request.to_tick
    if first is not None and last is not None and first >= last:
        raise ValueError(f"found from_tick {first} and to_tick {last}, expected the first below the other")
    return request


class ReconstructRequest(OfCapture):
    """A reconstruction of a capture; what is not given is decided by the plan.

    `budget_s` bounds the wall seconds up to the last checkpoint, `steps` the training steps; give at most one. `span`
    is the most planes of a span of a long recording. All workers share the spans, so its `budget_s` counts the seconds
    of each of them, and its `steps` are those of one span. A part is the ticks [from_tick, to_tick) of the rig clock;
    its instants are those of the whole. With `follow` the capture may still be recorded: the job shows looks at its
    newest planes until it is whole.
    """

    model_config = example(_CAPTURE | {"holdout": "cam11", "budget_s": 300}, {"type": "reconstruct"} | _CAPTURE)

    type: Literal["reconstruct"] = "reconstruct"
    model: Annotated[str, _choice("model")] = "auto"
    images: Annotated[str, _choice("images")] = "auto"
    init: Annotated[str, _choice("init")] = "auto"
    points: Annotated[str, _choice("points")] = "auto"
    supervision: Annotated[str, _choice("supervision")] = "auto"
    refine: Annotated[str, _choice("refine")] = "auto"
    pixels: Annotated[str, _choice("pixels")] = "auto"
    gains: Annotated[str, _choice("gains")] = "auto"
    device: Annotated[str, _choice("device")] = "auto"
    holdout: CameraKey | None = None
    views: Annotated[list[CameraKey] | None, Field(min_length=2, max_length=100)] = None
    tick_stride: Annotated[int | None, Field(ge=1, le=10_000)] = None
    span: Annotated[int | None, Field(ge=LEAST, le=10_000_000)] = None
    from_tick: Tick | None = None
    to_tick: Tick | None = None
    budget_s: Annotated[float | None, Field(gt=0, le=7 * 24 * 3600, allow_inf_nan=False)] = None
    steps: Annotated[int | None, Field(ge=1, le=10_000_000)] = None
    seed: Annotated[int | None, Field(ge=0, lt=2**31)] = None
    follow: bool = False

    _ticks = model_validator(mode="after")(_some_ticks)

    @model_validator(mode="after")
    def _one_bound(self) -> ReconstructRequest:
        if self.budget_s is not None and self.steps is not None:
            raise ValueError("found both budget_s and steps, expected at most one")
        return self

    @model_validator(mode="after")
    def _follows_all(self) -> ReconstructRequest:
        if self.follow and (self.from_tick is not None or self.to_tick is not None):
            raise ValueError("found follow with from_tick or to_tick, expected all of the capture")
        return self


class ImagesRequest(OfCapture):
    """Intensity images of every camera at the planes A:B:STEP: every 20th by itself, fewer of long captures."""

    model_config = example({"type": "images"} | _CAPTURE | {"method": "tfi", "ticks": "0:400:20"})

    type: Literal["images"]
    method: Annotated[str, OneOf([name for name in _choice("images").names if name != "auto"])]
    ticks: Planes | None = None


class CalibrateRequest(OfCapture):
    """A calibration of the rig from a capture: from a board that is waved before it, or from whatever it sees.

    With `dark`, a capture without light, the pixels are calibrated, and `capture` is one under even light. The result
    becomes a version of the calibration of `rig`, if one is named, and with `apply` the current one.
    """

    model_config = example({"type": "calibrate"} | _CAPTURE | {"board": "charuco:6x4:100:67.5:DICT_4X4_50"})

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
    """A check whether the calibration that a capture was recorded with, or the current one of `rig`, still fits it."""

    model_config = example({"type": "check-rig"} | _CAPTURE)

    type: Literal["check-rig"]
    rig: RigId | None = None


class VerifyRequest(OfCapture):
    """A check whether every byte of a capture is as it was written."""

    model_config = example({"type": "verify"} | _CAPTURE)

    type: Literal["verify"]


class EvaluateRequest(OfJob):
    """Scores of a reconstruction on its held-out camera."""

    model_config = example({"type": "evaluate"} | _JOB)

    type: Literal["evaluate"]


class RenderRequest(OfJob):
    """Pictures and depth from other cameras; `cameras` is the upload of a transforms.json whose frames have a time."""

    model_config = example({"type": "render"} | _JOB | {"cameras": "u20260101-120000-0a1b2c3d"})

    type: Literal["render"]
    cameras: EntryId


class ExportRequest(OfJob):
    """A reconstruction in another program's format; `at_s`, `frames` and ticks are as of `spike4dgs export`."""

    model_config = example({"type": "export"} | _JOB | {"format": "spz", "at_s": 0.01})

    type: Literal["export"]
    format: Annotated[str, OneOf([name for name, form in FORMATS.items() if form.served])]
    at_s: Annotated[float | None, Field(ge=0, le=1e6, allow_inf_nan=False)] = None
    frames: Annotated[int | None, Field(ge=1, le=1000)] = None
    camera: CameraKey | None = None
    from_tick: Tick | None = None
    to_tick: Tick | None = None

    _ticks = model_validator(mode="after")(_some_ticks)


class PreflightRequest(JobBase):
    """A check for everything that would spoil a recording: cameras, links, clocks, and the disk for `disk_seconds`."""

    type: Literal["preflight"] = "preflight"
    disk_seconds: Annotated[float, Field(ge=0.1, le=30, allow_inf_nan=False)] = 2.0


class LookRequest(JobBase):
    """A picture through a rig's cameras now, made of a few planes that are not kept."""

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
    tag.tag: model for model, tag in map(get_args, get_args(get_args(JobRequest)[0]))
}
RIG_JOB_TYPES: dict[str, type[JobBase]] = {"preflight": PreflightRequest, "look": LookRequest}
RigJobRequest = Annotated[PreflightRequest | LookRequest, Discriminator("type")]


class BatchRequest(Request):
    """Jobs to queue together: all of them or, where one is refused, none."""

    model_config = example({"jobs": [{"type": "verify"} | _CAPTURE, _CAPTURE | {"steps": 500}]})

    jobs: Annotated[list[JobRequest], Field(min_length=1, max_length=1000)]


class PriorityRequest(Request):
    """A new priority of a queued job: the lower is done earlier."""

    model_config = example({"priority": 10})

    priority: Annotated[int, Field(ge=1, le=1000)]


class RestartRequest(Request):
    """The stage from which on an ended reconstruction is done again."""

    model_config = example({"stage": "train"})

    stage: Annotated[str, OneOf(STAGES)]
