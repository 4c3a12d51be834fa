"""Problem documents (RFC 9457), and the one table from error types to HTTP."""

from __future__ import annotations

import errno
import json
import re
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException

from acquisition.errors import DiskError
from rigs.errors import RigError, Spike4dgsError
from server.errors import (
    BusyClientError,
    DigestError,
    ForbiddenError,
    ForeignRequestError,
    IdempotencyError,
    MalformedError,
    NotFoundError,
    OffsetError,
    PreconditionError,
    PreconditionRequiredError,
    RigBusyError,
    RigMismatchError,
    SlowBodyError,
    StateError,
    TargetError,
    TooLargeError,
    UnauthorizedError,
    UnknownReferenceError,
    UploadDiskError,
    UploadSizeError,
)
from server.middleware.headers import protect

_MOST_FAULTS = 20  # of one request; an answer stays short whatever came

STATUS: dict[type[Exception], int] = {
    NotFoundError: 404,
    RigBusyError: 409,
    StateError: 409,
    UnknownReferenceError: 422,
    IdempotencyError: 422,
    TargetError: 422,
    PreconditionError: 412,
    PreconditionRequiredError: 428,
    RigMismatchError: 422,
    RigError: 422,
    ForeignRequestError: 403,
    OffsetError: 409,
    UploadSizeError: 413,
    DigestError: 422,
    UploadDiskError: 507,
    UnauthorizedError: 401,
    ForbiddenError: 403,
    BusyClientError: 429,
    TooLargeError: 413,
    SlowBodyError: 408,
    MalformedError: 400,
    DiskError: 507,
    Spike4dgsError: 500,
}


class ProblemResponse(JSONResponse):
    """An answer of the type application/problem+json."""

    media_type = "application/problem+json"

    def render(self, content: Any) -> bytes:
        """In ASCII, so that whatever was found can be said, halves of surrogate pairs included."""
        return json.dumps(content, allow_nan=False, separators=(",", ":")).encode("ascii")


def problem(status: int, detail: str, kind: str = "", **members: Any) -> JSONResponse:
    """An RFC 9457 problem document; `kind` becomes its type, a URN."""
    body = {
        "type": f"urn:spike4dgs:{kind}" if kind else "about:blank",
        "title": HTTPStatus(status).phrase,
        "status": status,
        "detail": detail,
        **members,
    }
    return ProblemResponse(body, status)


def problem_of(error: Exception) -> JSONResponse:
    """The problem document of an error this project raises on purpose."""
    status = next(STATUS[kind] for kind in type(error).__mro__ if kind in STATUS)
    name = type(error).__name__.removesuffix("Error")
    response = problem(status, str(error), re.sub(r"(?<!^)(?=[A-Z])", "-", name).lower())
    response.headers.update(getattr(error, "headers", {}))
    return response


def install(app: FastAPI) -> None:
    """Answer every error of `app` with a problem document."""

    @app.exception_handler(Spike4dgsError)
    def expected(request: Request, error: Spike4dgsError) -> JSONResponse:
        return problem_of(error)

    @app.exception_handler(HTTPException)
    def http(request: Request, error: HTTPException) -> JSONResponse:
        response = problem(error.status_code, str(error.detail))
        response.headers.update(error.headers or {})
        return response

    @app.exception_handler(RequestValidationError)
    def invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        faults = [
            {
                "where": ".".join(str(part)[:80] for part in fault["loc"]),
                "found": _short(fault.get("input")),
                "message": _cut(fault["msg"], 500),
            }
            for fault in error.errors()[:_MOST_FAULTS]
        ]
        first = faults[0]
        detail = f"{first['where']}: found {first['found']}; {first['message']}"
        return problem(422, detail, "invalid-request", errors=faults)

    @app.exception_handler(SQLAlchemyError)
    def database(request: Request, error: SQLAlchemyError) -> JSONResponse:
        reason = str(getattr(error, "orig", error)).splitlines()[0]
        if "disk is full" in reason:
            return problem(507, "No space left for the database; free some", "disk-full")
        return problem(503, f"the database refused: {reason[:200]}", "database")

    @app.exception_handler(OSError)
    def system(request: Request, error: OSError) -> JSONResponse:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        return problem(507 if full else 500, error.strerror or "the system refused", "disk-full" if full else "system")

    @app.exception_handler(Exception)
    def unexpected(request: Request, error: Exception) -> JSONResponse:
        answer = problem(500, "an error this service did not expect; its log says more", "unexpected")
        protect(answer.headers, request.url.path, secret=True)  # this handler stands outside of every middleware
        return answer


def _short(value: object) -> str:
    return _cut(repr(value), 80)


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 3]}..."
