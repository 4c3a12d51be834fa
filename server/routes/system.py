"""What the service is and how it is."""

from importlib.metadata import version

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse

from server.engine import stages_of
from server.middleware.problems import problem
from server.routes.services import TheServices
from server.schemas.job_types import JOB_TYPES
from server.schemas.system import Check, Info, Workers
from server.store.tokens import Token

router = APIRouter(tags=["system"])


@router.get("/info")
def info(request: Request) -> Info:
    """Name, version, the stages of a reconstruction, and what the request's token allows."""
    token: Token | None = request.state.token
    role = token.role if token else None
    return Info(name="spike4dgs", version=version("spike4dgs"), stages=stages_of("reconstruct"), role=role)


@router.get("/options")
def options() -> dict[str, dict[str, object]]:
    """The JSON Schema of every type of job."""
    return {name: model.model_json_schema() for name, model in JOB_TYPES.items()}


@router.get("/workers")
def workers(services: TheServices) -> Workers:
    """The workers that are alive."""
    return services.health.workers()


@router.get("/healthz")
def healthz() -> dict[str, bool]:
    """The process answers."""
    return {"ok": True}


@router.get("/readyz", response_model=dict[str, Check])
def readyz(services: TheServices) -> dict[str, Check] | JSONResponse:
    """Work would be done: database, disk and worker. 503 where one is not."""
    checks = services.health.checks()
    faults = [f"{name}: {check.found}" for name, check in checks.items() if not check.ok]
    if faults:
        found = {name: check.model_dump() for name, check in checks.items()}
        return problem(503, "; ".join(faults), "not-ready", checks=found)
    return checks
