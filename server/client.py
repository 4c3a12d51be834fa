"""A thin typed client of the service."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from types import TracebackType
from typing import Any

import httpx

from server.calls.calibrations import CalibrationCalls
from server.calls.captures import CaptureCalls
from server.calls.events import EventCalls
from server.calls.transport import RefusedError
from server.calls.webhooks import WebhookCalls
from server.schemas.artefacts import Artefact, Artefacts
from server.schemas.captures import Capture, CaptureRequest, Captures
from server.schemas.job_types import JobBase, PriorityRequest, RestartRequest
from server.schemas.jobs import Job, Jobs, Step, Steps
from server.schemas.rigs import RigInfo, Rigs
from server.schemas.system import Check, Info, WorkerInfo, Workers

__all__ = ["RefusedError", "ServiceClient"]


class ServiceClient(CalibrationCalls, CaptureCalls, EventCalls, WebhookCalls):
    """Talks to a service; raises RefusedError for a problem and httpx.TransportError where nothing answers."""

    @classmethod
    def at(cls, address: str, token: str | None = None) -> ServiceClient:
        """A client of the service at `address`, such as http://127.0.0.1:8000, with a token if it asks."""
        headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        return cls(httpx.Client(base_url=address, timeout=30, trust_env=False, headers=headers))

    def __enter__(self) -> ServiceClient:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._http.close()

    # System

    def info(self) -> Info:
        """What the service is."""
        return self._get("/info", Info)

    def options(self) -> dict[str, dict[str, Any]]:
        """The JSON Schema of every type of job."""
        return self._checked(self._http.get("/v1/options")).json()

    def checks(self) -> dict[str, Check]:
        """The conditions of being ready, met or not."""
        found = self._http.get("/v1/readyz").json()
        return {name: Check(**check) for name, check in found.get("checks", found).items()}

    def workers(self) -> list[WorkerInfo]:
        """The workers that are alive."""
        return self._get("/workers", Workers).items

    # Rigs and captures

    def rigs(self) -> list[RigInfo]:
        """All rigs."""
        return self._get("/rigs", Rigs).items

    def rig(self, rig_id: str) -> RigInfo:
        """One rig."""
        return self._get(f"/rigs/{rig_id}", RigInfo)

    def start_capture(self, rig_id: str, request: CaptureRequest) -> Capture:
        """Record."""
        return self._post(f"/rigs/{rig_id}/captures", Capture, request)

    def stop_capture(self, capture: Capture) -> Capture:
        """End a recording; what it has is kept."""
        return self._post(f"/rigs/{capture.rig}/captures/{capture.id}/stop", Capture)

    def save_capture(self, capture: Capture) -> Capture:
        """Keep what the pre-trigger holds, and record on from there."""
        return self._post(f"/rigs/{capture.rig}/captures/{capture.id}/save", Capture)

    def captures(self, **filters: str | int) -> list[Capture]:
        """Captures, newest first; `rig`, `name`, `status`, `cursor`, `limit`."""
        return self._get("/captures", Captures, **filters).items

    def capture(self, capture_id: str) -> Capture:
        """One capture."""
        return self._get(f"/captures/{capture_id}", Capture)

    def delete_capture(self, capture_id: str) -> None:
        """Delete a capture with its recording."""
        self._checked(self._http.delete(f"/v1/captures/{capture_id}"))

    # Jobs

    def submit(self, request: JobBase) -> Job:
        """Queue a job."""
        return self._post("/jobs", Job, request)

    def submit_all(self, requests: Sequence[JobBase]) -> list[Job]:
        """Queue many jobs: all of them or, where one is refused, none."""
        body = {"jobs": [request.model_dump(exclude_none=True) for request in requests]}
        answer = self._http.post("/v1/jobs:batch", json=body, headers={"Idempotency-Key": uuid.uuid4().hex})
        return Jobs.model_validate_json(self._checked(answer).content).items

    def jobs(self, **filters: str | int) -> list[Job]:
        """Jobs, newest first; `type`, `rig`, `capture`, `name`, `status`, `cursor`, `limit`."""
        return self._get("/jobs", Jobs, **filters).items

    def job(self, job_id: str) -> Job:
        """One job."""
        return self._get(f"/jobs/{job_id}", Job)

    def steps(self, job_id: str) -> list[Step]:
        """The stages of a job, in order."""
        return self._get(f"/jobs/{job_id}/steps", Steps).items

    def cancel(self, job_id: str) -> Job:
        """Stop a job."""
        return self._post(f"/jobs/{job_id}/cancel", Job)

    def resume(self, job_id: str) -> Job:
        """Take a failed or cancelled job up again."""
        return self._post(f"/jobs/{job_id}/resume", Job)

    def restart(self, job_id: str, stage: str) -> Job:
        """Do an ended reconstruction again from a stage on."""
        return self._post(f"/jobs/{job_id}/restart", Job, RestartRequest.model_validate({"stage": stage}))

    def prioritise(self, job_id: str, priority: int) -> Job:
        """Move a queued job forward (a lower number) or back."""
        body = PriorityRequest(priority=priority).model_dump()
        return Job.model_validate_json(self._checked(self._http.put(f"/v1/jobs/{job_id}/priority", json=body)).content)

    def delete_job(self, job_id: str) -> None:
        """Delete an ended job and what it made."""
        self._checked(self._http.delete(f"/v1/jobs/{job_id}"))

    def log(self, job_id: str, line: int = 0) -> str:
        """What a job's stages wrote, from a line on."""
        return self._checked(self._http.get(f"/v1/jobs/{job_id}/log", params={"line": line})).text

    def artefacts(self, job_id: str) -> list[Artefact]:
        """What a job has made so far."""
        return self._get(f"/jobs/{job_id}/artefacts", Artefacts).items

    def artefact(self, job_id: str, name: str) -> bytes:
        """One artefact."""
        return self._checked(self._http.get(f"/v1/jobs/{job_id}/artefacts/{name}")).content

    def archive(self, job_id: str) -> bytes:
        """All artefacts of an ended job as one zip."""
        return self._checked(self._http.get(f"/v1/jobs/{job_id}/archive")).content

    def thumbnail(self, job_id: str) -> bytes:
        """A small picture of what was reconstructed."""
        return self._checked(self._http.get(f"/v1/jobs/{job_id}/thumbnail")).content
