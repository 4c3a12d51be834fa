"""Rigs, and the captures they are told to make."""

from fastapi import APIRouter, Response

from server.routes.service import TheService
from server.schemas import Capture, CaptureRequest, RigInfo, Rigs

router = APIRouter(prefix="/rigs", tags=["rigs"])


@router.get("")
def rigs(service: TheService) -> Rigs:
    """All rigs."""
    return Rigs(items=[service.rig(rig_id) for rig_id in service.rigs])


@router.get("/{rig_id}")
def rig(rig_id: str, service: TheService) -> RigInfo:
    """One rig: its cameras, its devices, and whether it is recording."""
    return service.rig(rig_id)


@router.post("/{rig_id}/captures", status_code=202)
def start_capture(rig_id: str, request: CaptureRequest, response: Response, service: TheService) -> Capture:
    """Record; 409 while the rig is recording already."""
    capture = service.start_capture(rig_id, request)
    response.headers["Location"] = f"/v1/captures/{capture.id}"
    return capture
