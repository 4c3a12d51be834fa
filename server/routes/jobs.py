"""Jobs and their results."""

import base64
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse, PlainTextResponse, StreamingResponse

from server.etags import tag
from server.ranges import cut, ranges_of
from server.routes import parameters
from server.routes.parameters import MAKES_ROOM, Again, IdempotencyKey, IfNoneMatch, TheServices, located, not_modified
from server.schemas.captures import Labels
from server.schemas.job_types import BatchRequest, JobRequest, PriorityRequest, RestartRequest
from server.schemas.jobs import Artefacts, CameraPictures, Job, Jobs, Order, Steps
from server.schemas.progress import Status
from server.store.entries import Filter
from server.store.tables import StoredArtefact

Cursor = Annotated[str | None, parameters.cursor_of("j", ordered=True)]
router = APIRouter(tags=["jobs"])
_FILE: dict[int | str, dict[str, Any]] = {
    200: {"content": {"*/*": {}}, "description": "The file; ETag is its SHA-256."},
    206: {"description": "The requested Range."},
    304: {"description": "The client already has it."},
    416: {"description": "There is no such Range."},
}
_ZIP: dict[int | str, dict[str, Any]] = _FILE | {200: {"content": {"application/zip": {}}, "description": "A zip."}}


@router.post("/jobs", status_code=202)
def submit_job(request: JobRequest, response: Response, services: TheServices, key: IdempotencyKey = None) -> Job:
    """Queue a job: a reconstruction unless its `type` says otherwise."""
    (job_id,) = services.jobs.submit([request], key)
    return located(response, "jobs", services.jobs.get(job_id))


@router.post("/jobs:batch", status_code=202)
def submit_batch(request: BatchRequest, services: TheServices, key: IdempotencyKey = None) -> Jobs:
    """Queue many jobs in their order: all of them or, if one is refused, none."""
    ids = services.jobs.submit(request.jobs, key)
    return services.jobs.find(ids)


@router.get("/jobs", response_model=Jobs)
def list_jobs(
    services: TheServices,
    type: parameters.Word = None,
    rig: parameters.Named = None,
    capture: parameters.Word = None,
    name: parameters.Named = None,
    status: Status | None = None,
    q: parameters.Searched = None,
    order: Order = "newest",
    cursor: Cursor = None,
    limit: parameters.Limit = 100,
) -> Response:
    """List jobs, newest first; in the order of the work: what runs, what is queued as it is taken, what has ended."""
    page = services.jobs.page(Filter("job", type, rig, capture, name, cursor, q), status, limit, order)
    return Response(page, media_type="application/json")


@router.get("/jobs/{job_id}")
def get_job(job_id: str, services: TheServices) -> Job:
    """Return one job: its state, stage, progress, seconds by stage, and error."""
    return services.jobs.get(job_id)


@router.patch("/jobs/{job_id}")
def label_job(job_id: str, labels: Labels, services: TheServices) -> Job:
    """Give a job another name or a note."""
    return services.jobs.label(job_id, labels)


@router.delete("/jobs/{job_id}", status_code=204, dependencies=[MAKES_ROOM])
def delete_job(job_id: str, services: TheServices) -> None:
    """Delete an ended job and its results."""
    services.jobs.delete(job_id)


@router.get("/jobs/{job_id}/steps")
def list_steps(job_id: str, services: TheServices) -> Steps:
    """List the stages of a job, in order."""
    return services.jobs.steps(job_id)


@router.post("/jobs/{job_id}/cancel", dependencies=[MAKES_ROOM])
def cancel_job(job_id: str, services: TheServices, again: Again) -> Job:
    """Stop a queued or running job and keep what it has made so far."""
    return services.jobs.get(job_id) if again else services.jobs.cancel(job_id)


@router.post("/jobs/{job_id}/resume", status_code=202)
def resume_job(job_id: str, response: Response, services: TheServices, again: Again) -> Job:
    """Resume a failed or cancelled job where it stopped."""
    return located(response, "jobs", services.jobs.get(job_id) if again else services.jobs.resume(job_id))


@router.post("/jobs/{job_id}/restart", status_code=202)
def restart_job(job_id: str, request: RestartRequest, response: Response, services: TheServices, again: Again) -> Job:
    """Repeat an ended reconstruction from a stage on."""
    jobs = services.jobs
    return located(response, "jobs", jobs.get(job_id) if again else jobs.restart(job_id, request.stage))


@router.put("/jobs/{job_id}/priority")
def prioritise_job(job_id: str, request: PriorityRequest, services: TheServices) -> Job:
    """Move a queued job forward or back."""
    return services.jobs.prioritise(job_id, request.priority)


@router.get("/jobs/{job_id}/log", response_class=PlainTextResponse)
def get_job_log(job_id: str, services: TheServices, line: Annotated[int, Query(ge=0)] = 0) -> str:
    """Return the log of the stages, as text, from a line on."""
    return services.jobs.log(job_id, line)


@router.get("/jobs/{job_id}/artefacts")
def list_artefacts(job_id: str, services: TheServices) -> Artefacts:
    """List what the job has made so far."""
    return Artefacts(items=services.artefacts.list(job_id))


@router.get("/jobs/{job_id}/artefacts/{name:path}", response_class=FileResponse, responses=_FILE)
@router.head("/jobs/{job_id}/artefacts/{name:path}", include_in_schema=False)
def get_artefact(
    job_id: str, name: str, request: Request, services: TheServices, if_none_match: IfNoneMatch = None
) -> Response:
    """Return one artefact; Range, If-Range and If-None-Match are honoured, and Repr-Digest has its SHA-256."""
    return _file(*services.artefacts.find(job_id, name), request, if_none_match)


@router.get("/jobs/{job_id}/thumbnail", response_class=FileResponse, responses=_FILE)
@router.head("/jobs/{job_id}/thumbnail", include_in_schema=False)
def get_thumbnail(job_id: str, request: Request, services: TheServices, if_none_match: IfNoneMatch = None) -> Response:
    """Return a small picture of the reconstruction."""
    found = services.artefacts.find(job_id, services.artefacts.thumbnail(job_id))
    return _file(*found, request, if_none_match)


@router.get("/jobs/{job_id}/preview", responses=parameters.PNG, response_class=Response)
def get_job_preview(
    job_id: str, services: TheServices, if_none_match: IfNoneMatch = None, of: parameters.Word = None
) -> Response:
    """Show what a reconstruction has learnt so far, as its held-out or middle camera would see it, as a PNG.

    The job's `preview` says after how many steps it was drawn, and when. `of` is any word that makes the address a new
    one.
    """
    return parameters.png(if_none_match, services.pictures.preview(job_id))


@router.get("/jobs/{job_id}/pictures")
def describe_pictures(job_id: str, services: TheServices) -> CameraPictures:
    """Say which pictures of its cameras a finished reconstruction can be compared with, and how they are made."""
    return services.pictures.of(job_id)


@router.get("/jobs/{job_id}/pictures/{camera_id}", responses=parameters.PNG, response_class=Response)
def get_picture(
    job_id: str,
    camera_id: str,
    plane: Annotated[int, Query(ge=0)],
    services: TheServices,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Show what a camera saw at a plane as a PNG: reconstructed from spikes, not the truth; as bright as the render."""
    return parameters.png(if_none_match, services.pictures.picture(job_id, camera_id, plane))


@router.get("/jobs/{job_id}/archive", response_class=StreamingResponse, responses=_ZIP)
@router.head("/jobs/{job_id}/archive", include_in_schema=False)
def get_archive(job_id: str, request: Request, services: TheServices, if_none_match: IfNoneMatch = None) -> Response:
    """Return all artefacts of an ended job as one zip; Range, of one range, and If-None-Match are honoured."""
    archive = services.artefacts.archive(job_id)
    headers = {"ETag": archive.etag, "Cache-Control": "no-cache", "Accept-Ranges": "bytes"}
    if known := not_modified(if_none_match, headers):
        return known
    status, parts, size = 200, archive.parts, archive.size
    asked = request.headers.get("range")
    if asked is not None and request.headers.get("if-range", archive.etag) == archive.etag:
        ranges = ranges_of(asked, size)
        if len(ranges) == 1:
            (first, end), status = ranges[0], 206
            headers["Content-Range"] = f"bytes {first}-{end - 1}/{archive.size}"
            parts, size = cut(parts, first, end), end - first
    headers |= {"Content-Length": str(size), "Content-Disposition": f'attachment; filename="{job_id}.zip"'}
    if request.method == "HEAD":
        return Response(status_code=status, media_type="application/zip", headers=headers)
    return StreamingResponse(parts, status, media_type="application/zip", headers=headers)


def _file(path: Path, found: StoredArtefact, request: Request, if_none_match: str | None) -> Response:
    in_parts = "range" in request.headers
    if in_parts and "if-range" not in request.headers:
        ranges_of(request.headers["range"], path.stat().st_size)  # else the framework answers in words of its own
    digest = f"sha-256=:{base64.b64encode(bytes.fromhex(found.sha256)).decode()}:"
    headers = {"ETag": tag(found.sha256), "Repr-Digest": digest, "Cache-Control": "no-cache"}
    whole = {} if in_parts else {"Content-Digest": digest}
    return not_modified(if_none_match, headers) or _File(
        path, media_type=found.media_type, headers=headers | whole, stat_result=path.stat()
    )


class _File(FileResponse):
    chunk_size = 2**20  # bytes; each is a turn of a thread, and most artefacts are smaller
