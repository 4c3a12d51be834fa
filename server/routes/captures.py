"""Captures, made or in the making."""

from typing import Annotated

from fastapi import APIRouter, Response
from fastapi.responses import PlainTextResponse

from server.routes import parameters
from server.routes.parameters import MAKES_ROOM, Again, IdempotencyKey, IfNoneMatch, TheServices, located, png
from server.schemas.captures import Capture, Captures, ImportRequest, Labels, ManifestInfo
from server.schemas.pictures import CaptureFigures
from server.schemas.progress import Status
from server.store.entries import Filter

Cursor = Annotated[str | None, parameters.cursor_of("c")]
router = APIRouter(tags=["captures"])


@router.get("/captures", response_model=Captures)
def list_captures(
    services: TheServices,
    rig: parameters.Named = None,
    name: parameters.Named = None,
    status: Status | None = None,
    q: parameters.Searched = None,
    cursor: Cursor = None,
    limit: parameters.Limit = 100,
) -> Response:
    """List captures, newest first."""
    page = services.captures.page(Filter("capture", rig=rig, name=name, before=cursor, q=q), status, limit)
    return Response(page, media_type="application/json")


@router.get("/captures/{capture_id}")
def get_capture(capture_id: str, services: TheServices) -> Capture:
    """Return one capture."""
    return services.captures.get(capture_id)


@router.post("/captures:import", status_code=202)
def import_capture(
    request: ImportRequest, response: Response, services: TheServices, key: IdempotencyKey = None
) -> Capture:
    """Make a capture of committed uploads, one `.dat` a camera."""
    return located(response, "captures", services.captures.get(services.imports.start(request, key)))


@router.get("/captures/{capture_id}/manifest")
def get_manifest(capture_id: str, services: TheServices) -> ManifestInfo:
    """Tell what a capture holds and lacks: planes, drops by layer, gaps, skew, and whether it was verified."""
    return services.previews.manifest(capture_id)


@router.get("/captures/{capture_id}/preview", responses=parameters.PNG, response_class=Response)
def get_preview(capture_id: str, services: TheServices, if_none_match: IfNoneMatch = None) -> Response:
    """Show all cameras in one PNG: the mean of planes from the middle, brightened for the eye."""
    return png(if_none_match, services.previews.sheet(capture_id))


@router.get("/captures/{capture_id}/preview/{camera_id}", responses=parameters.PNG, response_class=Response)
def get_camera_preview(
    capture_id: str, camera_id: str, services: TheServices, if_none_match: IfNoneMatch = None
) -> Response:
    """Show one camera as a PNG in its own size."""
    return png(if_none_match, services.previews.camera(capture_id, camera_id))


@router.get("/captures/{capture_id}/figures")
def get_figures(capture_id: str, services: TheServices) -> CaptureFigures:
    """Tell how sharp and how bright each camera's preview is."""
    return services.previews.figures(capture_id)


@router.get("/captures/{capture_id}/log", response_class=PlainTextResponse)
def get_capture_log(capture_id: str, services: TheServices) -> str:
    """Return the log of making a capture, as text; it has the warnings of an import."""
    return services.captures.log(capture_id)


@router.post("/captures/{capture_id}/cancel", dependencies=[MAKES_ROOM])
def cancel_import(capture_id: str, services: TheServices, again: Again) -> Capture:
    """Give up an import that is queued or running."""
    return services.captures.get(capture_id) if again else services.captures.cancel(capture_id)


@router.post("/captures/{capture_id}/finalise", status_code=202)
def finalise_capture(capture_id: str, services: TheServices, again: Again) -> Capture:
    """Make a recording of the planes that a recorder which failed has left: `partial_planes` of the capture."""
    return services.captures.get(capture_id) if again else services.captures.finalise(capture_id)


@router.patch("/captures/{capture_id}")
def label_capture(capture_id: str, labels: Labels, services: TheServices) -> Capture:
    """Give a capture another name or a note."""
    return services.captures.label(capture_id, labels)


@router.delete("/captures/{capture_id}", status_code=204, dependencies=[MAKES_ROOM])
def delete_capture(capture_id: str, services: TheServices) -> None:
    """Delete a capture with its recording; 409 while it is being made or a job uses it."""
    services.captures.delete(capture_id)
