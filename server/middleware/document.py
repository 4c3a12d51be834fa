"""The OpenAPI document: the framework derives it from the routes; tokens and refusals are added here."""

import json
from collections.abc import Iterator
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel, Field
from sqlalchemy.exc import SQLAlchemyError

from server import errors
from server.middleware.gate import is_guarded
from server.middleware.problems import ProblemResponse, problem_of
from server.schemas.progress import Event, Progress


class Fault(BaseModel):
    """A fault of a request that does not fit the schema."""

    where: str
    found: str
    message: str


class Problem(BaseModel):
    """The reason why a request was refused (RFC 9457); `detail` is one line for a person."""

    type: str = Field(description="A URN of the kind of problem, or about:blank.")
    title: str
    status: int = Field(ge=400, le=599)
    detail: str
    errors: list[Fault] = Field(default=[], description="Every fault of a request that does not fit the schema.")


# What may go wrong with a request: when it does, and one such error.
REFUSALS: tuple[tuple[str, Exception], ...] = (
    ("The body cannot be read.", errors.MalformedError("found NaN", "a number: JSON has no other")),
    (
        "The service has tokens and the request has none of them.",
        errors.UnauthorizedError("found no token", "Authorization: Bearer and a token of this service"),
    ),
    (
        "The token does not allow this, or the request came through another name or page.",
        errors.ForbiddenError("found the viewer wall-screen", "an operator's token for POST"),
    ),
    (
        "Nothing has this id or name.",
        errors.NotFoundError("found no job j20260101-000000-00000000", "one that GET /v1/jobs lists"),
    ),
    ("The body does not arrive.", errors.SlowBodyError("found the body unfinished after 30 s", "all of it")),
    (
        "Its state does not allow this.",
        errors.StateError("found j20260101-000000-00000000 done", "it queued or running"),
    ),
    (
        "It is no longer what the client saw.",
        errors.PreconditionError('found version "lab3x3-4" in use', '"lab3x3-3"', "look again before you change it"),
    ),
    ("The body is too long.", errors.TooLargeError("found a body of 2000000 bytes", "at most 1048576")),
    ("There is no such Range.", errors.RangeError("bytes=900-", 800)),
    ("The request does not fit.", errors.UnknownReferenceError("found the camera cam99", "one of cam00, cam01, cam02")),
    (
        "The request does not say what it changes.",
        errors.PreconditionRequiredError("found no If-Match", "the ETag of the resource to change"),
    ),
    ("The client asks too often; Retry-After says when it may ask again.", errors.BusyClientError(1)),
    ("The service cannot work now.", SQLAlchemyError("database is locked")),
    ("The disk is full.", errors.UploadDiskError("No space left on device", 0)),
)


def describe(app: FastAPI) -> None:
    """Let `app` answer /openapi.json with the whole contract, made once, on the first request."""

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = get_openapi(
                title=app.title, version=app.version, routes=app.routes, webhooks=app.webhooks.routes
            )
            _complete(document)
            app.openapi_schema = document
        return app.openapi_schema

    app.openapi = openapi


def _complete(document: dict[str, Any]) -> None:
    components = document.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    for name in ("HTTPValidationError", "ValidationError"):  # the framework's own refusals are answered as ours
        schemas.pop(name, None)
    for model in (Problem, Event, Progress):
        found = model.model_json_schema(ref_template="#/components/schemas/{model}")
        schemas |= found.pop("$defs", {}) | {model.__name__: found}
    components["securitySchemes"] = {
        "token": {
            "type": "http",
            "scheme": "bearer",
            "description": "Of `spike4dgs token add`, where the service has tokens. Viewers read, operators do all.",
        }
    }
    refusals = _refusals()
    for path, item in document["paths"].items():
        for method, operation in item.items():
            if is_guarded(path):
                operation["security"] = [{"token": []}, {}]
            stream = operation["responses"].get("200", {}).get("content", {}).get("text/event-stream")
            if stream:  # the framework calls it a string beside
                stream["schema"].pop("type", None)
            for status in _statuses(path, method, operation):
                known = operation["responses"].get(str(status), {}).get("content", {})
                if status == 422 or not known:
                    operation["responses"][str(status)] = refusals[status]


def _statuses(path: str, method: str, operation: dict[str, Any]) -> Iterator[int]:
    yield from (403, 429)
    if is_guarded(path):
        yield from (401, 503)
    if "{" in path:
        yield from (404, 409)
    yield 422
    if "416" in operation["responses"]:
        yield 416
    if any(parameter["name"].lower() == "if-match" for parameter in operation.get("parameters", ())):
        yield from (412, 428)
    if method not in ("get", "head"):
        yield from (400, 408, 409, 413, 507)


def _refusals() -> dict[int, dict[str, Any]]:
    """Return the description of each refusal by its HTTP status, with the problem document of its error."""
    described = {}
    for when, error in REFUSALS:
        answer = problem_of(error)
        schema = {"$ref": "#/components/schemas/Problem"}
        content = {ProblemResponse.media_type: {"schema": schema, "example": json.loads(bytes(answer.body))}}
        described[answer.status_code] = {"description": when, "content": content}
    described[416]["headers"] = {"Content-Range": {"schema": {"type": "string"}}}
    described[429]["headers"] = {"Retry-After": {"schema": {"type": "integer", "minimum": 1}}}
    described[401]["headers"] = {"WWW-Authenticate": {"schema": {"type": "string"}}}
    return described
