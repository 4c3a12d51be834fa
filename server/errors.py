"""What the service refuses, and the one table from error types to HTTP."""

from __future__ import annotations

import errno
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


class ServiceError(Spike4dgsError):
    """Root of the errors raised by `server`."""


class NotFoundError(ServiceError):
    """No rig, capture, job or artefact has this name."""


class RigBusyError(ServiceError):
    """The rig is recording; it records one capture at a time."""


class StateError(ServiceError):
    """The capture or job is not in a state that allows this."""


class UnknownReferenceError(ServiceError):
    """The request names something that does not exist or does not fit."""


class ForeignRequestError(ServiceError):
    """The request came through a host name or from a page that is not this service's."""


class IdempotencyError(ServiceError):
    """An Idempotency-Key came again with another request."""


class PreconditionError(ServiceError):
    """What was to be changed is no longer what the client saw."""


class TargetError(ServiceError):
    """A webhook's address that is not spoken to."""


class WorkerRunningError(ServiceError):
    """Another worker has this name."""

    exit_code = 2


STATUS: dict[type[Exception], int] = {
    NotFoundError: 404,
    RigBusyError: 409,
    StateError: 409,
    UnknownReferenceError: 422,
    IdempotencyError: 422,
    TargetError: 422,
    PreconditionError: 412,
    RigError: 422,
    ForeignRequestError: 403,
    DiskError: 507,
    Spike4dgsError: 500,
}


def problem(status: int, detail: str, kind: str = "", **members: Any) -> JSONResponse:
    """An RFC 9457 problem document; `kind` becomes its type, a URN."""
    body = {
        "type": f"urn:spike4dgs:{kind}" if kind else "about:blank",
        "title": HTTPStatus(status).phrase,
        "status": status,
        "detail": detail,
        **members,
    }
    return JSONResponse(body, status, media_type="application/problem+json")


def problem_of(error: Exception) -> JSONResponse:
    """The problem document of an error this project raises on purpose."""
    status = next(STATUS[kind] for kind in type(error).__mro__ if kind in STATUS)
    name = type(error).__name__.removesuffix("Error")
    return problem(status, str(error), re.sub(r"(?<!^)(?=[A-Z])", "-", name).lower())


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
                "where": ".".join(str(part) for part in fault["loc"]),
                "found": _short(fault.get("input")),
                "message": fault["msg"],
            }
            for fault in error.errors()
        ]
        first = faults[0]
        return problem(
            422, f"{first['where']}: found {first['found']}; {first['message']}", "invalid-request", errors=faults
        )

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
        return problem(500, "an error this service did not expect; its log says more", "unexpected")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
