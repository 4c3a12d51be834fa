"""Problem documents (RFC 9457), and the one table from error types to HTTP statuses."""

import errno
import json
import logging
import re
from collections.abc import Callable
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.routing import Match

from acquisition.errors import DiskError
from rigs.errors import RigError, Spike4dgsError
from server import errors
from server.middleware.headers import protect
from server.store.database import is_full, is_outage, reason_of

_LOG = logging.getLogger(__name__)
_METHODS = ("DELETE", "GET", "HEAD", "PATCH", "POST", "PUT")
_MOST_FAULTS = 20  # of one request, so that an answer stays short
_STATUS: dict[int, tuple[type[Exception], ...]] = {
    400: (errors.MalformedError,),
    401: (errors.UnauthorizedError,),
    403: (errors.ForbiddenError, errors.ForeignRequestError),
    404: (errors.NotFoundError,),
    408: (errors.SlowBodyError,),
    409: (errors.OffsetError, errors.RigBusyError, errors.StateError),
    412: (errors.PreconditionError,),
    413: (errors.TooLargeError, errors.UploadSizeError),
    416: (errors.RangeError,),
    422: (
        errors.DigestError,
        errors.IdempotencyError,
        errors.RigMismatchError,
        errors.TargetError,
        errors.UnknownReferenceError,
        RigError,
    ),
    428: (errors.PreconditionRequiredError,),
    429: (errors.BusyClientError,),
    500: (Spike4dgsError,),
    507: (errors.NoRoomError, errors.UploadDiskError, DiskError),
}
STATUS = {kind: status for status, kinds in _STATUS.items() for kind in kinds}


class ProblemResponse(JSONResponse):
    """An answer of the type application/problem+json."""

    media_type = "application/problem+json"

    def render(self, content: Any) -> bytes:
        """Encode in ASCII, so that any input can be quoted, halves of surrogate pairs included."""
        return json.dumps(content, allow_nan=False, separators=(",", ":")).encode("ascii")


def problem(status: int, detail: str, kind: str = "", **members: Any) -> JSONResponse:
    """Return an RFC 9457 problem document; `kind` becomes its type, a URN."""
    body = {
        "type": f"urn:spike4dgs:{kind}" if kind else "about:blank",
        "title": HTTPStatus(status).phrase,
        "status": status,
        "detail": detail,
        **members,
    }
    return ProblemResponse(body, status)


def problem_of(error: Exception, shown: Callable[[str], str] = str) -> JSONResponse:
    """Return the problem document of an error of this project or of the database, in words that are `shown`."""
    if isinstance(error, SQLAlchemyError):
        if is_full(error):
            return problem(507, "No space left for the database; free some", "disk-full")
        if is_outage(error):  # its words may name the server's address
            _LOG.warning("the database does not answer: %s", reason_of(error))
            return problem(503, "the database does not answer; the service's log says more", "database")
        return problem(503, f"the database refused: {reason_of(error)[:200]}", "database")
    status = next(STATUS[kind] for kind in type(error).__mro__ if kind in STATUS)
    name = type(error).__name__.removesuffix("Error")
    response = problem(status, shown(str(error)), re.sub(r"(?<!^)(?=[A-Z])", "-", name).lower())
    response.headers.update(getattr(error, "headers", {}))
    return response


def install(app: FastAPI, shown: Callable[[str], str] = str) -> None:
    """Let `app` answer every error with a problem document, in words that are `shown`."""

    @app.exception_handler(Spike4dgsError)
    @app.exception_handler(SQLAlchemyError)
    def expected(request: Request, error: Exception) -> JSONResponse:
        return problem_of(error, shown)

    @app.exception_handler(HTTPException)
    def http(request: Request, error: HTTPException) -> JSONResponse:
        response = problem(error.status_code, str(error.detail))
        response.headers.update(error.headers or {})
        if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
            response.headers["Allow"] = _allowed(app, request)
        return response

    @app.exception_handler(RequestValidationError)
    def invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        faults = [
            {
                "where": ".".join(str(part)[:80] for part in fault["loc"]),
                "found": _cut(repr(fault.get("input")), 80),
                "message": _cut(fault["msg"], 500),
            }
            for fault in error.errors()[:_MOST_FAULTS]
        ]
        first = faults[0]
        detail = f"{first['where']}: found {first['found']}; {first['message']}"
        return problem(422, detail, "invalid-request", errors=faults)

    @app.exception_handler(OSError)
    def system(request: Request, error: OSError) -> JSONResponse:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        return problem(507 if full else 500, error.strerror or "the system refused", "disk-full" if full else "system")

    @app.exception_handler(Exception)
    def unexpected(request: Request, error: Exception) -> JSONResponse:
        answer = problem(500, "an error this service did not expect; its log says more", "unexpected")
        protect(answer.headers, request.url.path, secret=True)  # this handler stands outside of every middleware
        return answer


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 3]}..."


def _allowed(app: FastAPI, request: Request) -> str:
    """Return all methods that a path has; the framework's own answer names those of its first route."""
    asked = {method: {**request.scope, "method": method} for method in _METHODS}
    return ", ".join(m for m in asked if any(route.matches(asked[m])[0] == Match.FULL for route in app.routes))
