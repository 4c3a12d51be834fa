"""The service itself: its version, its choices and its health."""

from importlib.metadata import version

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, PlainTextResponse, Response
from prometheus_client import CONTENT_TYPE_LATEST

from reconstruction.run.configuration import STAGES
from server.middleware.problems import problem
from server.routes.parameters import TheServices
from server.schemas.job_types import JOB_TYPES
from server.schemas.system import Check, Info, Workers
from server.store.tables import Token

router = APIRouter(tags=["system"])
metrics_router = APIRouter(tags=["system"])


@router.get("/info")
def get_info(request: Request) -> Info:
    """Return name, version, the stages of a reconstruction, and what the request's token allows."""
    token: Token | None = request.state.token
    role = token.role if token else None
    return Info(name="spike4dgs", version=version("spike4dgs"), stages=STAGES, role=role)


@router.get("/options")
def get_options() -> dict[str, dict[str, object]]:
    """Return the JSON Schema of every type of job."""
    return {name: model.model_json_schema() for name, model in JOB_TYPES.items()}


@router.get("/workers")
def list_workers(services: TheServices) -> Workers:
    """List the workers that are alive."""
    return services.health.workers()


@router.get("/healthz")
def get_health() -> dict[str, bool]:
    """Answer: the process is alive."""
    return {"ok": True}


@router.get("/readyz", response_model=dict[str, Check])
def get_readiness(request: Request, services: TheServices) -> dict[str, Check] | JSONResponse:
    """Tell whether a job would run: database, disk and worker. 503 if one of them is not ready.

    A request without the token that all others need is told the status alone.
    """
    checks = services.health.checks()
    faults = [f"{name}: {check.found}" for name, check in checks.items() if not check.ok]
    stranger = services.access.guards and request.state.token is None
    if faults and stranger:
        return problem(503, "not ready", "not-ready")
    if faults:
        found = {name: check.model_dump() for name, check in checks.items()}
        return problem(503, "; ".join(faults), "not-ready", checks=found)
    return {} if stranger else checks


@metrics_router.get("/metrics", response_class=PlainTextResponse)
def get_metrics(services: TheServices) -> Response:
    """Report queues, stages, failures, drops, disk, workers, accelerators and requests in Prometheus' text format."""
    return Response(services.metrics.text(), media_type=CONTENT_TYPE_LATEST)
