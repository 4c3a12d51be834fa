"""What the service is and how it is."""

from importlib.metadata import version

from fastapi import APIRouter
from fastapi.responses import JSONResponse

from server.errors import problem
from server.jobs import RECONSTRUCTION_STAGES
from server.routes.service import TheService
from server.schemas import Check, Info

router = APIRouter(tags=["system"])


@router.get("/info")
def info() -> Info:
    """Name, version, and the stages of a reconstruction."""
    return Info(name="spike4dgs", version=version("spike4dgs"), stages=RECONSTRUCTION_STAGES)


@router.get("/healthz")
def healthz() -> dict[str, bool]:
    """The process answers."""
    return {"ok": True}


@router.get("/readyz", response_model=dict[str, Check])
def readyz(service: TheService) -> dict[str, Check] | JSONResponse:
    """Work would be done: database, disk and worker. 503 where one is not."""
    checks = service.checks()
    faults = [f"{name}: {check.found}" for name, check in checks.items() if not check.ok]
    if faults:
        found = {name: check.model_dump() for name, check in checks.items()}
        return problem(503, "; ".join(faults), "not-ready", checks=found)
    return checks
