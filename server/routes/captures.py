"""Captures, made or in the making."""

from fastapi import APIRouter, Response
from fastapi.responses import PlainTextResponse

from server.routes import parameters
from server.routes.parameters import MAKES_ROOM, IdempotencyKey, IfNoneMatch, TheServices, located, png
from server.schemas.captures import Capture, Captures, ImportRequest, ManifestInfo
from server.schemas.progress import Status
from server.store.entries import Filter

router = APIRouter(tags=["captures"])


@router.get("/captures", response_model=Captures)
def captures(
    services: TheServices,
    rig: parameters.Word = None,
    name: parameters.Named = None,
    status: Status | None = None,
    cursor: parameters.Cursor = None,
    limit: parameters.Limit = 100,
) -> Response:
    """List captures, newest first."""
    page = services.captures.page(Filter("capture", rig=rig, name=name, before=cursor), status, limit)
    return Response(page, media_type="application/json")


@router.get("/captures/{capture_id}")
def capture(capture_id: str, services: TheServices) -> Capture:
    """Return one capture."""
    return services.captures.get(capture_id)


@router.post("/captures:import", status_code=202)
def import_capture(
    request: ImportRequest, response: Response, services: TheServices, key: IdempotencyKey = None
) -> Capture:
    """Make a capture of committed uploads, one `.dat` a camera."""
    return located(response, "captures", services.captures.get(services.imports.start(request, key)))


@router.get("/captures/{capture_id}/manifest")
def manifest(capture_id: str, services: TheServices) -> ManifestInfo:
    """Tell what a capture holds and lacks: planes, drops by layer, gaps, skew, and whether it was verified."""
    return services.previews.manifest(capture_id)


@router.get("/captures/{capture_id}/preview", responses=parameters.PNG, response_class=Response)
def preview(capture_id: str, services: TheServices, if_none_match: IfNoneMatch = None) -> Response:
    """Show all cameras in one PNG: the mean of planes from the middle, brightened for the eye."""
    return png(if_none_match, services.previews.sheet(capture_id))


@router.get("/captures/{capture_id}/preview/{camera_id}", responses=parameters.PNG, response_class=Response)
def camera_preview(
    capture_id: str, camera_id: str, services: TheServices, if_none_match: IfNoneMatch = None
) -> Response:
    """Show one camera as a PNG in its own size."""
    return png(if_none_match, services.previews.camera(capture_id, camera_id))


@router.get("/captures/{capture_id}/log", response_class=PlainTextResponse)
def log(capture_id: str, services: TheServices) -> str:
    """Return the log of making a capture, as text; it has the warnings of an import."""
    return services.captures.log(capture_id)


@router.post("/captures/{capture_id}/cancel", dependencies=[MAKES_ROOM])
def cancel(capture_id: str, services: TheServices) -> Capture:
    """Give up an import, or stop a recording and keep what it has."""
    return services.captures.cancel(capture_id)


@router.post("/captures/{capture_id}/finalise", status_code=202)
def finalise(capture_id: str, services: TheServices) -> Capture:
    """Make a recording of the planes that a recorder which failed has left: `partial_planes` of the capture."""
    return services.captures.finalise(capture_id)


@router.delete("/captures/{capture_id}", status_code=204, dependencies=[MAKES_ROOM])
def delete_capture(capture_id: str, services: TheServices) -> None:
    """Delete a capture with its recording; 409 while it is being made or a job uses it."""
    services.captures.delete(capture_id)
