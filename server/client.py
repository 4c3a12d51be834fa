"""A thin typed client of the service."""

from __future__ import annotations

from types import TracebackType
from typing import TypeVar

import httpx
from pydantic import BaseModel

from server.errors import ServiceError
from server.schemas import (
    Artefact,
    Artefacts,
    Capture,
    CaptureRequest,
    Captures,
    Check,
    Info,
    Job,
    JobRequest,
    Jobs,
    RigInfo,
    Rigs,
)

_M = TypeVar("_M", bound=BaseModel)


class RefusedError(ServiceError):
    """The service answered with a problem; the message is its detail."""

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.status = status
        self.exit_code = 2 if 400 <= status < 500 else 1


class ServiceClient:
    """Talks to a service; raises RefusedError for a problem and httpx.TransportError where nothing answers."""

    def __init__(self, http: httpx.Client) -> None:
        self._http = http

    @classmethod
    def at(cls, address: str) -> ServiceClient:
        """A client of the service at `address`, such as http://127.0.0.1:8000."""
        return cls(httpx.Client(base_url=address, timeout=30, trust_env=False))

    def __enter__(self) -> ServiceClient:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._http.close()

    def info(self) -> Info:
        """What the service is."""
        return self._get("/info", Info)

    def checks(self) -> dict[str, Check]:
        """The conditions of being ready, met or not."""
        response = self._http.get("/v1/readyz")
        found = response.json()
        return {name: Check(**check) for name, check in found.get("checks", found).items()}

    def rigs(self) -> list[RigInfo]:
        """All rigs."""
        return self._get("/rigs", Rigs).items

    def rig(self, rig_id: str) -> RigInfo:
        """One rig."""
        return self._get(f"/rigs/{rig_id}", RigInfo)

    def start_capture(self, rig_id: str, request: CaptureRequest) -> Capture:
        """Record."""
        return self._post(f"/rigs/{rig_id}/captures", Capture, request)

    def captures(self) -> list[Capture]:
        """All captures, newest first."""
        return self._get("/captures", Captures).items

    def capture(self, capture_id: str) -> Capture:
        """One capture."""
        return self._get(f"/captures/{capture_id}", Capture)

    def submit(self, request: JobRequest) -> Job:
        """Reconstruct a capture."""
        return self._post("/jobs", Job, request)

    def jobs(self) -> list[Job]:
        """All jobs, newest first."""
        return self._get("/jobs", Jobs).items

    def job(self, job_id: str) -> Job:
        """One job."""
        return self._get(f"/jobs/{job_id}", Job)

    def cancel(self, job_id: str) -> Job:
        """Stop a job."""
        return self._post(f"/jobs/{job_id}/cancel", Job)

    def resume(self, job_id: str) -> Job:
        """Take a failed or cancelled job up again."""
        return self._post(f"/jobs/{job_id}/resume", Job)

    def log(self, job_id: str) -> str:
        """What a job's stages wrote."""
        return self._checked(self._http.get(f"/v1/jobs/{job_id}/log")).text

    def artefacts(self, job_id: str) -> list[Artefact]:
        """What a job has made so far."""
        return self._get(f"/jobs/{job_id}/artefacts", Artefacts).items

    def artefact(self, job_id: str, name: str) -> bytes:
        """One artefact."""
        return self._checked(self._http.get(f"/v1/jobs/{job_id}/artefacts/{name}")).content

    def _get(self, path: str, model: type[_M]) -> _M:
        return model.model_validate_json(self._checked(self._http.get(f"/v1{path}")).content)

    def _post(self, path: str, model: type[_M], request: BaseModel | None = None) -> _M:
        body = None if request is None else request.model_dump(exclude_none=True)
        return model.model_validate_json(self._checked(self._http.post(f"/v1{path}", json=body)).content)

    @staticmethod
    def _checked(response: httpx.Response) -> httpx.Response:
        if response.is_error:
            raise RefusedError(response.status_code, response.json()["detail"])
        return response
