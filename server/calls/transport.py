"""Sends the requests of a client of the service, and reads the answers."""

import time
import uuid
from collections.abc import Generator
from typing import Any, TypeVar
from urllib.parse import quote

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


class Patience(httpx.Auth):
    """Repeats a request that was one too many (429) as soon as the service allows it."""

    _MOST_TIMES = 5
    _MOST_S = 10

    def auth_flow(self, request: httpx.Request) -> Generator[httpx.Request, httpx.Response, None]:
        """Yield the request until it is accepted or the wait is too long; the last answer counts."""
        for _ in range(self._MOST_TIMES):
            response = yield request
            wait_s = response.headers.get("Retry-After", "")
            if response.status_code != httpx.codes.TOO_MANY_REQUESTS or not wait_s.isdecimal():
                return
            if int(wait_s) > self._MOST_S:
                return
            time.sleep(int(wait_s))
        yield request


class Transport:
    """Requests over `http`; raises RefusedError for a problem and httpx.TransportError if nothing answers."""

    def __init__(self, http: httpx.Client) -> None:
        self._http = http
        self._http.auth = Patience()

    def _send(self, method: str, path: str, **request: Any) -> httpx.Response:
        return self._checked(self._http.send(self._http.build_request(method, f"/v1{path}", **request)))

    def _ask(self, model: type[_M], method: str, path: str, **request: Any) -> _M:
        return model.model_validate_json(self._send(method, path, **request).content)

    def _get(self, path: str, model: type[_M], **parameters: str | int) -> _M:
        return self._ask(model, "GET", path, params=parameters)

    def _post(self, path: str, model: type[_M], request: BaseModel | None = None, **options: Any) -> _M:
        body = None if request is None else request.model_dump(exclude_none=True)
        headers = {"Idempotency-Key": uuid.uuid4().hex}  # a transport may repeat a request that got no answer
        return self._ask(model, "POST", path, json=body, headers=headers, **options)

    @staticmethod
    def _checked(response: httpx.Response) -> httpx.Response:
        if response.is_error:
            raise RefusedError(response.status_code, _detail(response))
        return response


def at_rig(rig_id: str) -> str:
    """Return the address of a rig, whose name may have characters that mean something in addresses."""
    return f"/rigs/{quote(rig_id, safe='')}"


def _detail(response: httpx.Response) -> str:
    """Return the detail of a problem document, or the status of an answer that is of a proxy or the bare server."""
    try:
        return str(response.json()["detail"])
    except (ValueError, TypeError, KeyError):
        found = f"found the answer {response.status_code} {response.reason_phrase}".strip()
        return f"{found}, expected one of the service; look whether it runs"
