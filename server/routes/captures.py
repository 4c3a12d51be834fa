"""Captures, made or in the making."""

from fastapi import APIRouter

from server.routes.service import TheService
from server.schemas import Capture, Captures

router = APIRouter(prefix="/captures", tags=["captures"])


@router.get("")
def captures(service: TheService) -> Captures:
    """All captures, newest first."""
    return Captures(items=service.captures())


@router.get("/{capture_id}")
def capture(capture_id: str, service: TheService) -> Capture:
    """One capture."""
    return service.capture(capture_id)
