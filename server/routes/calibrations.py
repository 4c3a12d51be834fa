"""The calibrations of a rig: found by jobs or uploaded, and the one in use."""

from typing import Annotated

from fastapi import APIRouter, Header, Path, Response
from fastapi.responses import FileResponse

from server.etags import matches, tag
from server.routes.services import IdempotencyKey, TheServices
from server.schemas.calibrations import (
    Calibration,
    CalibrationChoice,
    CalibrationRequest,
    Calibrations,
    CurrentCalibration,
    RigCheckRequest,
)
from server.schemas.jobs import Job

router = APIRouter(prefix="/rigs/{rig_id}", tags=["calibrations"])
Version = Annotated[int, Path(ge=0, le=2**31 - 1, description="0 is the rig as it was drawn.")]
IfMatch = Annotated[str | None, Header(alias="If-Match", max_length=500)]
IfNoneMatch = Annotated[str | None, Header(alias="If-None-Match", max_length=500)]
_PLAIN = {"X-Content-Type-Options": "nosniff"}


@router.post("/calibrations", status_code=202)
def calibrate(
    rig_id: str, request: CalibrationRequest, response: Response, services: TheServices, key: IdempotencyKey = None
) -> Job:
    """Queue a calibration; its job is at Location, and what it finds becomes a version."""
    job = services.jobs.get(services.calibrations.submit(rig_id, request, key))
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return job


@router.get("/calibrations")
def calibrations(rig_id: str, services: TheServices) -> Calibrations:
    """All calibrations of the rig, newest first."""
    return services.calibrations.list(rig_id)


@router.get("/calibrations/{version}")
def version(rig_id: str, version: Version, services: TheServices) -> Calibration:
    """One calibration: when and how it was found, and how good each camera is."""
    return services.calibrations.get(rig_id, version)


@router.get("/calibrations/{version}/rig.toml", response_class=Response)
def document(rig_id: str, version: Version, services: TheServices) -> Response:
    """Its rig file."""
    found = services.calibrations.document(rig_id, version)
    headers = _PLAIN | {"ETag": tag(found.sha256)}
    return Response(found.document, media_type="application/toml", headers=headers)


@router.get("/calibrations/{version}/picture", response_class=FileResponse)
def picture(rig_id: str, version: Version, services: TheServices) -> FileResponse:
    """How far from where it should each camera saw each point."""
    return FileResponse(services.calibrations.picture(rig_id, version), media_type="image/png", headers=_PLAIN)


@router.get("/calibration", response_model=CurrentCalibration)
def current(
    rig_id: str, response: Response, services: TheServices, if_none_match: IfNoneMatch = None
) -> CurrentCalibration | Response:
    """The calibration in use; 304 where If-None-Match has its ETag."""
    found = services.calibrations.current(rig_id)
    etag = tag(rig_id, found.revision)
    headers = {"ETag": etag, "Cache-Control": "no-cache"}
    if if_none_match is not None and matches(if_none_match, etag, weak=True):
        return Response(status_code=304, headers=headers)
    response.headers.update(headers)
    return found


@router.put("/calibration")
def choose(
    rig_id: str, choice: CalibrationChoice, response: Response, services: TheServices, if_match: IfMatch = None
) -> CurrentCalibration:
    """Use another version or a rig file; 428 without If-Match, 412 where it is not the ETag any more."""
    found = services.calibrations.choose(rig_id, choice, if_match)
    response.headers["ETag"] = tag(rig_id, found.revision)
    return found


@router.post("/calibration/check", status_code=202)
def check(
    rig_id: str, request: RigCheckRequest, response: Response, services: TheServices, key: IdempotencyKey = None
) -> Job:
    """Queue a comparison of the current calibration with what a capture saw; `result.json` of the job answers."""
    job = services.jobs.get(services.calibrations.check(rig_id, request, key))
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return job
