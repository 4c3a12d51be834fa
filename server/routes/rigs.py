"""Rigs, and the captures they are told to make."""

from fastapi import APIRouter, Response

from server.routes import parameters
from server.routes.parameters import MAKES_ROOM, PNG, Again, IdempotencyKey, IfNoneMatch, TheServices, located, png
from server.schemas.captures import Capture, CaptureRequest
from server.schemas.job_types import LookRequest, PreflightRequest
from server.schemas.jobs import Job
from server.schemas.pictures import LookFigures
from server.schemas.rigs import RigInfo, Rigs, RigStatus

router = APIRouter(prefix="/rigs", tags=["rigs"])


@router.get("")
def list_rigs(services: TheServices) -> Rigs:
    """List all rigs."""
    return services.rigs.list()


@router.get("/{rig_id}")
def get_rig(rig_id: str, services: TheServices) -> RigInfo:
    """Return one rig: its cameras, its devices, and whether it is recording."""
    return services.rigs.get(rig_id)


@router.post("/{rig_id}/captures", status_code=202)
def start_capture(
    rig_id: str, request: CaptureRequest, response: Response, services: TheServices, key: IdempotencyKey = None
) -> Capture:
    """Record; 409 while the rig is recording already, 507 where the disk has no room for it."""
    return located(response, "captures", services.captures.get(services.rigs.start(rig_id, request, key)))


@router.post("/{rig_id}/captures/{capture_id}/stop", dependencies=[MAKES_ROOM])
def stop_capture(rig_id: str, capture_id: str, services: TheServices, again: Again) -> Capture:
    """End a recording and keep what it has; one that was stopped before anything was kept is cancelled."""
    return services.captures.get(capture_id) if again else services.captures.tell(rig_id, capture_id, "stop")


@router.post("/{rig_id}/captures/{capture_id}/save")
def save_capture(rig_id: str, capture_id: str, services: TheServices, again: Again) -> Capture:
    """Keep what the pre-trigger holds, and record on from there."""
    return services.captures.get(capture_id) if again else services.captures.tell(rig_id, capture_id, "save")


@router.get("/{rig_id}/status")
def get_rig_status(rig_id: str, services: TheServices) -> RigStatus:
    """Tell what a rig is doing, its room on the disk, its calibration, and what the last preflight found."""
    return services.rig_jobs.status(rig_id)


@router.post("/{rig_id}/preflight", status_code=202)
def start_preflight(
    rig_id: str,
    response: Response,
    services: TheServices,
    request: PreflightRequest | None = None,
    key: IdempotencyKey = None,
) -> Job:
    """Check everything that could spoil a recording; 409 while the rig is busy."""
    job_id = services.rig_jobs.start(rig_id, request or PreflightRequest(), key)
    return located(response, "jobs", services.jobs.get(job_id))


@router.post("/{rig_id}/look", status_code=202)
def start_look(
    rig_id: str,
    response: Response,
    services: TheServices,
    request: LookRequest | None = None,
    key: IdempotencyKey = None,
) -> Job:
    """Take a picture with all cameras, and keep nothing else; 409 while the rig is busy."""
    return located(response, "jobs", services.jobs.get(services.rig_jobs.start(rig_id, request or LookRequest(), key)))


@router.get("/{rig_id}/look")
def get_look(rig_id: str, services: TheServices) -> LookFigures:
    """Tell how sharp and how bright each camera's picture of the last look is."""
    return services.looks.figures(rig_id)


@router.get("/{rig_id}/look.png", responses=PNG, response_class=Response)
def get_look_picture(
    rig_id: str, services: TheServices, if_none_match: IfNoneMatch = None, of: parameters.Word = None
) -> Response:
    """Show what the cameras saw at the last look; `of` is any word that makes the address a new one."""
    return png(if_none_match, services.looks.sheet(rig_id))


@router.get("/{rig_id}/look/{camera_id}", responses=PNG, response_class=Response)
def get_camera_look(
    rig_id: str,
    camera_id: str,
    services: TheServices,
    if_none_match: IfNoneMatch = None,
    of: parameters.Word = None,
) -> Response:
    """Show what one camera saw at the last look, as a PNG in its own size, as bright as it needs."""
    return png(if_none_match, services.looks.camera(rig_id, camera_id))
