"""A thin typed client of the service."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import httpx

from server.calls.captures import CaptureCalls
from server.calls.events import EventCalls
from server.calls.rigs import RigCalls
from server.calls.transport import RefusedError
from server.schemas.captures import Labels
from server.schemas.job_types import BatchRequest, JobBase, PriorityRequest, RestartRequest
from server.schemas.jobs import Artefact, Artefacts, CameraPictures, Job, Jobs, Step, Steps
from server.schemas.system import Check, Info, WorkerInfo, Workers

__all__ = ["RefusedError", "ServiceClient"]


class ServiceClient(RigCalls, CaptureCalls, EventCalls):
    """Talks to a service; raises RefusedError for a problem and httpx.TransportError if nothing answers."""

    @classmethod
    def at(cls, address: str, token: str | None = None) -> ServiceClient:
        """Return a client of the service at `address`, such as http://127.0.0.1:8000, with a token if it needs one."""
        headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        return cls(httpx.Client(base_url=address, timeout=30, trust_env=False, headers=headers))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._http.close()

    def info(self) -> Info:
        """Return name, version and stages of the service, and the role of the token."""
        return self._get("/info", Info)

    def options(self) -> dict[str, dict[str, Any]]:
        """Return the JSON Schema of every type of job."""
        return self._send("GET", "/options").json()

    def checks(self) -> dict[str, Check]:
        """Return the conditions of being ready, met or not; raises RefusedError where the service tells none."""
        response = self._http.get("/v1/readyz")
        try:
            found = response.json()["checks"]
        except (ValueError, TypeError, KeyError):
            found = self._checked(response).json()
        return {name: Check(**check) for name, check in found.items()}

    def workers(self) -> list[WorkerInfo]:
        """List the workers that are alive."""
        return self._get("/workers", Workers).items

    def submit(self, request: JobBase) -> Job:
        """Queue a job."""
        return self._post("/jobs", Job, request)

    def submit_all(self, requests: Sequence[JobBase]) -> list[Job]:
        """Queue many jobs: all of them or, if one is refused, none."""
        return self._post("/jobs:batch", Jobs, BatchRequest.model_construct(jobs=list(requests))).items

    def jobs(self, **filters: str | int) -> list[Job]:
        """List jobs, newest first; filters: `type rig capture name status q order cursor limit`."""
        return self._get("/jobs", Jobs, **filters).items

    def job(self, job_id: str) -> Job:
        """Return one job."""
        return self._get(f"/jobs/{job_id}", Job)

    def steps(self, job_id: str) -> list[Step]:
        """List the stages of a job, in order."""
        return self._get(f"/jobs/{job_id}/steps", Steps).items

    def cancel(self, job_id: str) -> Job:
        """Stop a job."""
        return self._post(f"/jobs/{job_id}/cancel", Job)

    def resume(self, job_id: str) -> Job:
        """Resume a failed or cancelled job."""
        return self._post(f"/jobs/{job_id}/resume", Job)

    def restart(self, job_id: str, stage: str) -> Job:
        """Repeat an ended reconstruction from a stage on."""
        return self._post(f"/jobs/{job_id}/restart", Job, RestartRequest.model_validate({"stage": stage}))

    def prioritise(self, job_id: str, priority: int) -> Job:
        """Move a queued job forward (a lower number) or back."""
        return self._ask(Job, "PUT", f"/jobs/{job_id}/priority", json=PriorityRequest(priority=priority).model_dump())

    def label_job(self, job_id: str, labels: Labels) -> Job:
        """Give a job another name or a note."""
        return self._ask(Job, "PATCH", f"/jobs/{job_id}", json=labels.model_dump(exclude_unset=True))

    def delete_job(self, job_id: str) -> None:
        """Delete an ended job and its results."""
        self._send("DELETE", f"/jobs/{job_id}")

    def log(self, job_id: str, line: int = 0) -> str:
        """Return the log of a job's stages, from a line on."""
        return self._send("GET", f"/jobs/{job_id}/log", params={"line": line}).text

    def artefacts(self, job_id: str) -> list[Artefact]:
        """List what a job has made so far."""
        return self._get(f"/jobs/{job_id}/artefacts", Artefacts).items

    def artefact(self, job_id: str, name: str) -> bytes:
        """Return one artefact."""
        return self._send("GET", f"/jobs/{job_id}/artefacts/{name}").content

    def pictures(self, job_id: str) -> CameraPictures:
        """Say which pictures of its cameras a finished reconstruction can be compared with."""
        return self._get(f"/jobs/{job_id}/pictures", CameraPictures)

    def picture(self, job_id: str, camera_id: str, plane: int) -> bytes:
        """Return what a camera saw at a plane, as PNG: reconstructed from spikes, not the truth."""
        return self._send("GET", f"/jobs/{job_id}/pictures/{camera_id}", params={"plane": plane}).content

    def archive(self, job_id: str) -> bytes:
        """Return all artefacts of an ended job as one zip."""
        return self._send("GET", f"/jobs/{job_id}/archive").content

    def thumbnail(self, job_id: str) -> bytes:
        """Return a small picture of the reconstruction."""
        return self._send("GET", f"/jobs/{job_id}/thumbnail").content

    def job_preview(self, job_id: str) -> bytes:
        """Return what a reconstruction has learnt so far, as PNG: rendered as `Job.preview` says."""
        return self._send("GET", f"/jobs/{job_id}/preview").content
