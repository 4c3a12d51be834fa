"""Files that clients send, piece by piece."""

from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response

from acquisition.recording.importing import SourceFormat
from acquisition.spikes.layout import BitOrder, RowOrder
from server.errors import UnknownReferenceError
from server.routes.parameters import (
    MAKES_ROOM,
    PNG,
    Again,
    IdempotencyKey,
    IfNoneMatch,
    Limit,
    TheServices,
    cursor_of,
    located,
    png,
)
from server.schemas.uploads import Inspection, LayoutAsked, Upload, UploadRequest, Uploads

Cursor = Annotated[str | None, cursor_of("u")]
router = APIRouter(prefix="/uploads", tags=["uploads"])
Offset = Annotated[int, Header(alias="Upload-Offset", ge=0, lt=2**63, description="Where the body begins in the file.")]
Length = Annotated[int | None, Header(alias="Content-Length", ge=0, include_in_schema=False)]
Side = Annotated[int | None, Query(ge=1, le=9999, description="Pixels of its camera.")]
_BODY = {"requestBody": {"content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}}}


@router.post("", status_code=201)
def begin_upload(
    request: UploadRequest, response: Response, services: TheServices, key: IdempotencyKey = None
) -> Upload:
    """Begin an upload; 413 if it is longer than uploads may be, 507 if the disk has no room for it."""
    upload = services.uploads.create(request, key)
    _tell(response, upload)
    return located(response, "uploads", upload)


@router.get("")
def list_uploads(services: TheServices, cursor: Cursor = None, limit: Limit = 100) -> Uploads:
    """List uploads, newest first."""
    return services.uploads.list(cursor, limit)


@router.get("/{upload_id}")
def get_upload(upload_id: str, response: Response, services: TheServices) -> Upload:
    """Return one upload and how much of it has arrived."""
    found = services.uploads.get(upload_id)
    _tell(response, found)
    return found


@router.head("/{upload_id}")
def get_upload_offset(upload_id: str, services: TheServices) -> Response:
    """Tell how much of an upload has arrived, as the header Upload-Offset."""
    response = Response(headers={"Cache-Control": "no-store"})
    _tell(response, services.uploads.get(upload_id))
    return response


@router.patch("/{upload_id}", openapi_extra=_BODY)
async def append_to_upload(
    upload_id: str, request: Request, response: Response, services: TheServices, at: Offset, length: Length = None
) -> Upload:
    """Append the body; 409, with the right Upload-Offset, if it does not begin at the end of the last piece."""
    upload = await services.uploads.receive(upload_id, at, length, request.stream())
    _tell(response, upload)
    return upload


@router.get("/{upload_id}/inspection")
def inspect_upload(upload_id: str, services: TheServices, width: Side = None, height: Side = None) -> Inspection:
    """Tell which layouts an upload may have, as soon as some of it has come, of a size or of those that are known."""
    size = (width, height) if width is not None and height is not None else None
    if size is None and (width is not None or height is not None):
        raise UnknownReferenceError("found one of width and height", "both, or none")
    return services.inspections.inspection(upload_id, size)


@router.get("/{upload_id}/preview", responses=PNG, response_class=Response)
def get_upload_preview(
    upload_id: str,
    services: TheServices,
    format: SourceFormat = "vidar",
    width: Side = None,
    height: Side = None,
    bit_order: BitOrder = "lsb",
    row_order: RowOrder = "bottom",
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Show an upload in a layout, before it is imported: the mean of planes from the middle of its bytes so far."""
    asked = LayoutAsked(format=format, width=width, height=height, bit_order=bit_order, row_order=row_order)
    return png(if_none_match, services.inspections.picture(upload_id, asked))


@router.post("/{upload_id}/commit")
def commit_upload(upload_id: str, services: TheServices, again: Again) -> Upload:
    """Finish an upload: check its size and SHA-256, and let it be imported."""
    return services.uploads.get(upload_id) if again else services.uploads.commit(upload_id)


@router.delete("/{upload_id}", status_code=204, dependencies=[MAKES_ROOM])
def delete_upload(upload_id: str, services: TheServices) -> None:
    """Delete an upload, committed or not; 409 while it is written or imported."""
    services.uploads.delete(upload_id)


def _tell(response: Response, upload: Upload) -> None:
    response.headers["Upload-Offset"] = str(upload.offset)
    response.headers["Upload-Length"] = str(upload.bytes)
