"""Jobs and what they leave."""

import base64
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import FileResponse, PlainTextResponse, StreamingResponse

from server.routes.services import Cursor, IdempotencyKey, Limit, Named, TheServices, Word
from server.schemas.artefacts import Artefacts
from server.schemas.job_types import BatchRequest, JobRequest, PriorityRequest, RestartRequest
from server.schemas.jobs import Job, Jobs, Steps
from server.schemas.progress import Status
from server.store.artefacts import StoredArtefact
from server.store.entries import Filter

router = APIRouter(tags=["jobs"])
IfNoneMatch = Annotated[str | None, Header(alias="If-None-Match", max_length=4000)]
_FILE: dict[int | str, dict[str, Any]] = {
    200: {"content": {"*/*": {}}, "description": "The file; ETag is its SHA-256."},
    206: {"description": "The Range that was asked for."},
    304: {"description": "The client has it."},
    416: {"description": "There is no such Range."},
}
_ZIP: dict[int | str, dict[str, Any]] = {200: {"content": {"application/zip": {}}, "description": "A zip."}}


@router.post("/jobs", status_code=202)
def submit(request: JobRequest, response: Response, services: TheServices, key: IdempotencyKey = None) -> Job:
    """Queue a job: a reconstruction unless its `type` says otherwise."""
    (job_id,) = services.jobs.submit([request], key)
    response.headers["Location"] = f"/v1/jobs/{job_id}"
    return services.jobs.get(job_id)


@router.post("/jobs:batch", status_code=202)
def submit_batch(request: BatchRequest, services: TheServices, key: IdempotencyKey = None) -> Jobs:
    """Queue many jobs, in their order: all of them or, where one is refused, none."""
    ids = services.jobs.submit(request.jobs, key)
    return Jobs(items=[services.jobs.get(job_id) for job_id in ids])


@router.get("/jobs", response_model=Jobs)
def jobs(
    services: TheServices,
    type: Word = None,
    rig: Word = None,
    capture: Word = None,
    name: Named = None,
    status: Status | None = None,
    cursor: Cursor = None,
    limit: Limit = 100,
) -> Response:
    """Jobs, newest first."""
    page = services.jobs.page(Filter("job", type, rig, capture, name, cursor), status, limit)
    return Response(page, media_type="application/json")


@router.get("/jobs/{job_id}")
def job(job_id: str, services: TheServices) -> Job:
    """One job: its state, stage, progress, seconds by stage, and error."""
    return services.jobs.get(job_id)


@router.delete("/jobs/{job_id}", status_code=204)
def delete_job(job_id: str, services: TheServices) -> None:
    """Delete an ended job and what it made."""
    services.jobs.delete(job_id)


@router.get("/jobs/{job_id}/steps")
def steps(job_id: str, services: TheServices) -> Steps:
    """The stages of a job, in order."""
    return services.jobs.steps(job_id)


@router.post("/jobs/{job_id}/cancel")
def cancel(job_id: str, services: TheServices) -> Job:
    """Stop a queued or running job; what it has made so far stays."""
    return services.jobs.cancel(job_id)


@router.post("/jobs/{job_id}/resume", status_code=202)
def resume(job_id: str, response: Response, services: TheServices) -> Job:
    """Take a failed or cancelled job up again where it stopped."""
    job = services.jobs.resume(job_id)
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return job


@router.post("/jobs/{job_id}/restart", status_code=202)
def restart(job_id: str, request: RestartRequest, response: Response, services: TheServices) -> Job:
    """Do an ended reconstruction again from a stage on."""
    job = services.jobs.restart(job_id, request.stage)
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return job


@router.put("/jobs/{job_id}/priority")
def prioritise(job_id: str, request: PriorityRequest, services: TheServices) -> Job:
    """Move a queued job forward or back."""
    return services.jobs.prioritise(job_id, request.priority)


@router.get("/jobs/{job_id}/log", response_class=PlainTextResponse)
def log(job_id: str, services: TheServices, line: Annotated[int, Query(ge=0)] = 0) -> str:
    """What the stages wrote, as text, from a line on."""
    return services.jobs.log(job_id, line)


@router.get("/jobs/{job_id}/artefacts")
def artefacts(job_id: str, services: TheServices) -> Artefacts:
    """What the job has made so far."""
    return Artefacts(items=services.artefacts.list(job_id))


@router.get("/jobs/{job_id}/artefacts/{name:path}", response_class=FileResponse, responses=_FILE)
@router.head("/jobs/{job_id}/artefacts/{name:path}", include_in_schema=False)
def artefact(
    job_id: str, name: str, request: Request, services: TheServices, if_none_match: IfNoneMatch = None
) -> Response:
    """One artefact; Range, If-Range and If-None-Match are honoured, Repr-Digest proves it."""
    return _file(*services.artefacts.find(job_id, name), "range" in request.headers, if_none_match)


@router.get("/jobs/{job_id}/thumbnail", response_class=FileResponse, responses=_FILE)
@router.head("/jobs/{job_id}/thumbnail", include_in_schema=False)
def thumbnail(job_id: str, request: Request, services: TheServices, if_none_match: IfNoneMatch = None) -> Response:
    """A small picture of what was reconstructed."""
    found = services.artefacts.find(job_id, services.artefacts.thumbnail(job_id))
    return _file(*found, "range" in request.headers, if_none_match)


@router.get("/jobs/{job_id}/archive", response_class=StreamingResponse, responses=_ZIP)
def archive(job_id: str, services: TheServices) -> StreamingResponse:
    """All artefacts of an ended job as one zip."""
    length, parts = services.artefacts.archive(job_id)
    headers = {
        "Content-Length": str(length),
        "Content-Disposition": f'attachment; filename="{job_id}.zip"',
        "X-Content-Type-Options": "nosniff",
    }
    return StreamingResponse(parts, media_type="application/zip", headers=headers)


def _file(path: Path, found: StoredArtefact, in_parts: bool, if_none_match: str | None) -> Response:
    tag = f'"{found.sha256}"'
    digest = f"sha-256=:{base64.b64encode(bytes.fromhex(found.sha256)).decode()}:"
    headers = {"ETag": tag, "Repr-Digest": digest, "Cache-Control": "no-cache", "X-Content-Type-Options": "nosniff"}
    known = [one.strip().removeprefix("W/") for one in (if_none_match or "").split(",")]
    if tag in known or "*" in known:
        return Response(status_code=304, headers=headers)
    if not in_parts:  # what is sent is then the whole
        headers["Content-Digest"] = digest
    return _File(path, media_type=found.media_type, headers=headers, stat_result=path.stat())


class _File(FileResponse):
    chunk_size = 2**20  # each is a turn of a thread, and most artefacts are smaller
