"""Captures, made or in the making."""

from fastapi import APIRouter, Request, Response
from fastapi.responses import PlainTextResponse

from server.routes.pictures import PNG, answer
from server.routes.services import Cursor, IdempotencyKey, Limit, Named, TheServices, Word
from server.schemas.captures import Capture, Captures, ImportRequest, ManifestInfo
from server.schemas.progress import Status
from server.store.entries import Filter

router = APIRouter(tags=["captures"])


@router.get("/captures", response_model=Captures)
def captures(
    services: TheServices,
    rig: Word = None,
    name: Named = None,
    status: Status | None = None,
    cursor: Cursor = None,
    limit: Limit = 100,
) -> Response:
    """Captures, newest first."""
    page = services.captures.page(Filter("capture", rig=rig, name=name, before=cursor), status, limit)
    return Response(page, media_type="application/json")


@router.get("/captures/{capture_id}")
def capture(capture_id: str, services: TheServices) -> Capture:
    """One capture."""
    return services.captures.get(capture_id)


@router.post("/captures:import", status_code=202)
def import_capture(
    request: ImportRequest, response: Response, services: TheServices, key: IdempotencyKey = None
) -> Capture:
    """Make a capture of committed uploads, one `.dat` a camera."""
    capture = services.captures.get(services.imports.start(request, key))
    response.headers["Location"] = f"/v1/captures/{capture.id}"
    return capture


@router.get("/captures/{capture_id}/manifest")
def manifest(capture_id: str, services: TheServices) -> ManifestInfo:
    """What a capture holds and lacks: planes, drops by layer, gaps, skew, and whether it was verified."""
    return services.previews.manifest(capture_id)


@router.get("/captures/{capture_id}/preview", responses=PNG, response_class=Response)
def preview(capture_id: str, request: Request, services: TheServices) -> Response:
    """All cameras as one PNG: the mean of planes in the middle, as bright as a person wants to see it."""
    return answer(request, services.previews.sheet(capture_id))


@router.get("/captures/{capture_id}/preview/{camera_id}", responses=PNG, response_class=Response)
def camera_preview(capture_id: str, camera_id: str, request: Request, services: TheServices) -> Response:
    """One camera as a PNG in its own size."""
    return answer(request, services.previews.camera(capture_id, camera_id))


@router.get("/captures/{capture_id}/log", response_class=PlainTextResponse)
def log(capture_id: str, services: TheServices) -> str:
    """What making a capture said, as text: an import's doubts are here."""
    return services.captures.log(capture_id)


@router.post("/captures/{capture_id}/cancel")
def cancel(capture_id: str, services: TheServices) -> Capture:
    """Give up an import; a recording is stopped, which keeps what it has."""
    return services.captures.cancel(capture_id)


@router.delete("/captures/{capture_id}", status_code=204)
def delete_capture(capture_id: str, services: TheServices) -> None:
    """Delete a capture with its recording; 409 while it is being made or a job works on it."""
    services.captures.delete(capture_id)
