"""Reconstruction jobs and what they leave."""

from fastapi import APIRouter, Response
from fastapi.responses import FileResponse, PlainTextResponse

from server.routes.service import TheService
from server.schemas import Artefacts, Job, JobRequest, Jobs

router = APIRouter(prefix="/jobs", tags=["jobs"])


@router.post("", status_code=202)
def submit(request: JobRequest, response: Response, service: TheService) -> Job:
    """Reconstruct a capture."""
    job = service.submit(request)
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return job


@router.get("")
def jobs(service: TheService) -> Jobs:
    """All jobs, newest first."""
    return Jobs(items=service.jobs())


@router.get("/{job_id}")
def job(job_id: str, service: TheService) -> Job:
    """One job: its state, stage, progress, seconds by stage, and error."""
    return service.job(job_id)


@router.post("/{job_id}/cancel")
def cancel(job_id: str, service: TheService) -> Job:
    """Stop a queued or running job; what it has made so far stays."""
    return service.cancel(job_id)


@router.post("/{job_id}/resume", status_code=202)
def resume(job_id: str, response: Response, service: TheService) -> Job:
    """Take a failed or cancelled job up again where it stopped."""
    job = service.resume(job_id)
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return job


@router.get("/{job_id}/log", response_class=PlainTextResponse)
def log(job_id: str, service: TheService) -> str:
    """What the stages wrote, as text."""
    return service.log(job_id)


@router.get("/{job_id}/artefacts")
def artefacts(job_id: str, service: TheService) -> Artefacts:
    """What the job has made so far."""
    return Artefacts(items=service.artefacts(job_id))


@router.get("/{job_id}/artefacts/{name}", response_class=FileResponse)
def artefact(job_id: str, name: str, service: TheService) -> FileResponse:
    """One artefact; a Range is honoured."""
    path, media_type = service.artefact(job_id, name)
    return FileResponse(path, media_type=media_type, headers={"X-Content-Type-Options": "nosniff"})
