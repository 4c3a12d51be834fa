"""Jobs and their results."""

import base64
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse, PlainTextResponse, StreamingResponse

from server.etags import tag
from server.routes import parameters
from server.routes.parameters import MAKES_ROOM, IdempotencyKey, IfNoneMatch, TheServices, located, not_modified
from server.schemas.job_types import BatchRequest, JobRequest, PriorityRequest, RestartRequest
from server.schemas.jobs import Artefacts, Job, Jobs, Steps
from server.schemas.progress import Status
from server.store.entries import Filter
from server.store.tables import StoredArtefact

router = APIRouter(tags=["jobs"])
_FILE: dict[int | str, dict[str, Any]] = {
    200: {"content": {"*/*": {}}, "description": "The file; ETag is its SHA-256."},
    206: {"description": "The requested Range."},
    304: {"description": "The client already has it."},
    416: {"description": "There is no such Range."},
}
_ZIP: dict[int | str, dict[str, Any]] = {200: {"content": {"application/zip": {}}, "description": "A zip."}}


@router.post("/jobs", status_code=202)
def submit(request: JobRequest, response: Response, services: TheServices, key: IdempotencyKey = None) -> Job:
    """Queue a job: a reconstruction unless its `type` says otherwise."""
    (job_id,) = services.jobs.submit([request], key)
    return located(response, "jobs", services.jobs.get(job_id))


@router.post("/jobs:batch", status_code=202)
def submit_batch(request: BatchRequest, services: TheServices, key: IdempotencyKey = None) -> Jobs:
    """Queue many jobs in their order: all of them or, if one is refused, none."""
    ids = services.jobs.submit(request.jobs, key)
    return Jobs(items=[services.jobs.get(job_id) for job_id in ids])


@router.get("/jobs", response_model=Jobs)
def jobs(
    services: TheServices,
    type: parameters.Word = None,
    rig: parameters.Word = None,
    capture: parameters.Word = None,
    name: parameters.Named = None,
    status: Status | None = None,
    cursor: parameters.Cursor = None,
    limit: parameters.Limit = 100,
) -> Response:
    """List jobs, newest first."""
    page = services.jobs.page(Filter("job", type, rig, capture, name, cursor), status, limit)
    return Response(page, media_type="application/json")


@router.get("/jobs/{job_id}")
def job(job_id: str, services: TheServices) -> Job:
    """Return one job: its state, stage, progress, seconds by stage, and error."""
    return services.jobs.get(job_id)


@router.delete("/jobs/{job_id}", status_code=204, dependencies=[MAKES_ROOM])
def delete_job(job_id: str, services: TheServices) -> None:
    """Delete an ended job and its results."""
    services.jobs.delete(job_id)


@router.get("/jobs/{job_id}/steps")
def steps(job_id: str, services: TheServices) -> Steps:
    """List the stages of a job, in order."""
    return services.jobs.steps(job_id)


@router.post("/jobs/{job_id}/cancel", dependencies=[MAKES_ROOM])
def cancel(job_id: str, services: TheServices) -> Job:
    """Stop a queued or running job and keep what it has made so far."""
    return services.jobs.cancel(job_id)


@router.post("/jobs/{job_id}/resume", status_code=202)
def resume(job_id: str, response: Response, services: TheServices) -> Job:
    """Resume a failed or cancelled job where it stopped."""
    return located(response, "jobs", services.jobs.resume(job_id))


@router.post("/jobs/{job_id}/restart", status_code=202)
def restart(job_id: str, request: RestartRequest, response: Response, services: TheServices) -> Job:
    """Repeat an ended reconstruction from a stage on."""
    return located(response, "jobs", services.jobs.restart(job_id, request.stage))


@router.put("/jobs/{job_id}/priority")
def prioritise(job_id: str, request: PriorityRequest, services: TheServices) -> Job:
    """Move a queued job forward or back."""
    return services.jobs.prioritise(job_id, request.priority)


@router.get("/jobs/{job_id}/log", response_class=PlainTextResponse)
def log(job_id: str, services: TheServices, line: Annotated[int, Query(ge=0)] = 0) -> str:
    """Return the log of the stages, as text, from a line on."""
    return services.jobs.log(job_id, line)


@router.get("/jobs/{job_id}/artefacts")
def artefacts(job_id: str, services: TheServices) -> Artefacts:
    """List what the job has made so far."""
    return Artefacts(items=services.artefacts.list(job_id))


@router.get("/jobs/{job_id}/artefacts/{name:path}", response_class=FileResponse, responses=_FILE)
@router.head("/jobs/{job_id}/artefacts/{name:path}", include_in_schema=False)
def artefact(
    job_id: str, name: str, request: Request, services: TheServices, if_none_match: IfNoneMatch = None
) -> Response:
    """Return one artefact; Range, If-Range and If-None-Match are honoured, and Repr-Digest has its SHA-256."""
    return _file(*services.artefacts.find(job_id, name), "range" in request.headers, if_none_match)


@router.get("/jobs/{job_id}/thumbnail", response_class=FileResponse, responses=_FILE)
@router.head("/jobs/{job_id}/thumbnail", include_in_schema=False)
def thumbnail(job_id: str, request: Request, services: TheServices, if_none_match: IfNoneMatch = None) -> Response:
    """Return a small picture of the reconstruction."""
    found = services.artefacts.find(job_id, services.artefacts.thumbnail(job_id))
    return _file(*found, "range" in request.headers, if_none_match)


@router.get("/jobs/{job_id}/archive", response_class=StreamingResponse, responses=_ZIP)
def archive(job_id: str, services: TheServices) -> StreamingResponse:
    """Return all artefacts of an ended job as one zip."""
    length, parts = services.artefacts.archive(job_id)
    headers = {"Content-Length": str(length), "Content-Disposition": f'attachment; filename="{job_id}.zip"'}
    return StreamingResponse(parts, media_type="application/zip", headers=headers)


def _file(path: Path, found: StoredArtefact, in_parts: bool, if_none_match: str | None) -> Response:
    digest = f"sha-256=:{base64.b64encode(bytes.fromhex(found.sha256)).decode()}:"
    headers = {"ETag": tag(found.sha256), "Repr-Digest": digest, "Cache-Control": "no-cache"}
    whole = {} if in_parts else {"Content-Digest": digest}
    return not_modified(if_none_match, headers) or _File(
        path, media_type=found.media_type, headers=headers | whole, stat_result=path.stat()
    )


class _File(FileResponse):
    chunk_size = 2**20  # bytes; each is a turn of a thread, and most artefacts are smaller
