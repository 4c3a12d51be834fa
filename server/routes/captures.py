"""Captures, made or in the making."""

from fastapi import APIRouter

from server.routes.services import Cursor, Limit, Named, TheServices, Word
from server.schemas.captures import Capture, Captures
from server.schemas.progress import Status
from server.store.entries import Filter

router = APIRouter(prefix="/captures", tags=["captures"])


@router.get("")
def captures(
    services: TheServices,
    rig: Word = None,
    name: Named = None,
    status: Status | None = None,
    cursor: Cursor = None,
    limit: Limit = 100,
) -> Captures:
    """Captures, newest first."""
    return services.captures.list(Filter("capture", rig=rig, name=name, before=cursor), status, limit)


@router.get("/{capture_id}")
def capture(capture_id: str, services: TheServices) -> Capture:
    """One capture."""
    return services.captures.get(capture_id)


@router.delete("/{capture_id}", status_code=204)
def delete_capture(capture_id: str, services: TheServices) -> None:
    """Delete a capture with its recording; 409 while it is being made or a job works on it."""
    services.captures.delete(capture_id)
