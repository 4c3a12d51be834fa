"""Rigs, and the captures they are told to make."""

from fastapi import APIRouter, Response

from server.routes.services import IdempotencyKey, TheServices
from server.schemas.captures import Capture, CaptureRequest
from server.schemas.rigs import RigInfo, Rigs

router = APIRouter(prefix="/rigs", tags=["rigs"])


@router.get("")
def rigs(services: TheServices) -> Rigs:
    """All rigs."""
    return services.rigs.list()


@router.get("/{rig_id}")
def rig(rig_id: str, services: TheServices) -> RigInfo:
    """One rig: its cameras, its devices, and whether it is recording."""
    return services.rigs.get(rig_id)


@router.post("/{rig_id}/captures", status_code=202)
def start_capture(
    rig_id: str, request: CaptureRequest, response: Response, services: TheServices, key: IdempotencyKey = None
) -> Capture:
    """Record; 409 while the rig is recording already."""
    capture = services.captures.get(services.rigs.start(rig_id, request, key))
    response.headers["Location"] = f"/v1/captures/{capture.id}"
    return capture


@router.post("/{rig_id}/captures/{capture_id}/stop")
def stop_capture(rig_id: str, capture_id: str, services: TheServices) -> Capture:
    """End a recording; what it has is kept."""
    return services.captures.tell(capture_id, "stop")


@router.post("/{rig_id}/captures/{capture_id}/save")
def save_capture(rig_id: str, capture_id: str, services: TheServices) -> Capture:
    """Keep what the pre-trigger holds, and record on from there."""
    return services.captures.tell(capture_id, "save")
