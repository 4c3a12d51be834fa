"""How a client of the service sends requests and reads answers."""

from __future__ import annotations

import uuid
from typing import TypeVar

import httpx
from pydantic import BaseModel

from server.errors import ServiceError

_M = TypeVar("_M", bound=BaseModel)


class RefusedError(ServiceError):
    """The service answered with a problem; the message is its detail."""

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.status = status
        self.exit_code = 2 if 400 <= status < 500 else 1


class Transport:
    """Requests over `http`; raises RefusedError for a problem and httpx.TransportError where nothing answers."""

    def __init__(self, http: httpx.Client) -> None:
        self._http = http

    def _get(self, path: str, model: type[_M], **parameters: str | int) -> _M:
        return model.model_validate_json(self._checked(self._http.get(f"/v1{path}", params=parameters)).content)

    def _post(self, path: str, model: type[_M], request: BaseModel | None = None) -> _M:
        body = None if request is None else request.model_dump(exclude_none=True)
        headers = {"Idempotency-Key": uuid.uuid4().hex}  # a transport may send again what got no answer
        return model.model_validate_json(
            self._checked(self._http.post(f"/v1{path}", json=body, headers=headers)).content
        )

    @staticmethod
    def _checked(response: httpx.Response) -> httpx.Response:
        if response.is_error:
            raise RefusedError(response.status_code, response.json()["detail"])
        return response
