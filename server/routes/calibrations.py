"""The calibrations of a rig: found by jobs or uploaded, and the one in use."""

from typing import Annotated

from fastapi import APIRouter, Header, Path, Response
from fastapi.responses import FileResponse

from server.etags import tag
from server.routes.parameters import IdempotencyKey, IfNoneMatch, TheServices, located, not_modified
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


@router.post("/calibrations", status_code=202)
def start_calibration(
    rig_id: str, request: CalibrationRequest, response: Response, services: TheServices, key: IdempotencyKey = None
) -> Job:
    """Queue a calibration; its job is at Location, and its result becomes a version."""
    return located(response, "jobs", services.jobs.get(services.calibrations.submit(rig_id, request, key)))


@router.get("/calibrations")
def list_calibrations(rig_id: str, services: TheServices) -> Calibrations:
    """List all calibrations of the rig, newest first."""
    return services.calibrations.list(rig_id)


@router.get("/calibrations/{version}")
def get_calibration_version(rig_id: str, version: Version, services: TheServices) -> Calibration:
    """Return one calibration: when and how it was found, and how good each camera is."""
    return services.calibrations.get(rig_id, version)


@router.get("/calibrations/{version}/rig.toml", response_class=Response)
def get_calibration_file(rig_id: str, version: Version, services: TheServices) -> Response:
    """Return the rig file of a calibration."""
    found = services.calibrations.document(rig_id, version)
    return Response(found.document, media_type="application/toml", headers={"ETag": tag(found.sha256)})


@router.get("/calibrations/{version}/picture", response_class=FileResponse)
def get_calibration_picture(rig_id: str, version: Version, services: TheServices) -> FileResponse:
    """Return a picture of the residuals: how far from its place each camera saw each point."""
    return FileResponse(services.calibrations.picture(rig_id, version), media_type="image/png")


@router.get("/calibration", response_model=CurrentCalibration)
def get_calibration(
    rig_id: str, response: Response, services: TheServices, if_none_match: IfNoneMatch = None
) -> CurrentCalibration | Response:
    """Return the calibration in use, or 304 if its ETag is in If-None-Match."""
    found = services.calibrations.current(rig_id)
    headers = {"ETag": tag(rig_id, found.revision), "Cache-Control": "no-cache"}
    response.headers.update(headers)
    return not_modified(if_none_match, headers) or found


@router.put("/calibration")
def choose_calibration(
    rig_id: str, choice: CalibrationChoice, response: Response, services: TheServices, if_match: IfMatch = None
) -> CurrentCalibration:
    """Use another version or a rig file; 428 without If-Match, 412 if the calibration has changed since."""
    found = services.calibrations.choose(rig_id, choice, if_match)
    response.headers["ETag"] = tag(rig_id, found.revision)
    return found


@router.post("/calibration/check", status_code=202)
def check_calibration(
    rig_id: str, request: RigCheckRequest, response: Response, services: TheServices, key: IdempotencyKey = None
) -> Job:
    """Queue a comparison of the current calibration with a capture; the job's `result.json` has the answer."""
    return located(response, "jobs", services.jobs.get(services.calibrations.check(rig_id, request, key)))
