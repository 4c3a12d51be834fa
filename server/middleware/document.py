"""The OpenAPI document: what the framework derives from the routes, and what it cannot know of tokens and refusals."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from server.middleware.gate import is_guarded

_MEDIA_TYPE = "application/problem+json"
_METHODS = ("get", "head", "put", "post", "patch", "delete")

PROBLEM: dict[str, Any] = {
    "title": "Problem",
    "description": "Why a request was refused (RFC 9457); `detail` is one line for a person.",
    "type": "object",
    "required": ["type", "title", "status", "detail"],
    "properties": {
        "type": {"type": "string", "description": "A URN of the kind of problem, or about:blank."},
        "title": {"type": "string"},
        "status": {"type": "integer", "minimum": 400, "maximum": 599},
        "detail": {"type": "string"},
        "errors": {
            "type": "array",
            "description": "Every fault of a request that does not fit.",
            "items": {
                "type": "object",
                "required": ["where", "found", "message"],
                "properties": {name: {"type": "string"} for name in ("where", "found", "message")},
            },
        },
    },
}

# status: (when, type, title, detail)
REFUSALS: dict[int, tuple[str, str, str, str]] = {
    400: ("The body cannot be read.", "malformed", "Bad Request", "found NaN, expected a number: JSON has no other"),
    401: (
        "The service has tokens and the request has none of them.",
        "unauthorized",
        "Unauthorized",
        "found no token, expected Authorization: Bearer and a token of this service",
    ),
    403: (
        "The token does not allow this, or the request came through another name or page.",
        "forbidden",
        "Forbidden",
        "found the viewer wall-screen, expected an operator's token for POST",
    ),
    404: (
        "Nothing has this id or name.",
        "not-found",
        "Not Found",
        "found no job j20260101-000000-00000000, expected one that GET /v1/jobs lists",
    ),
    408: ("The body does not come.", "slow-body", "Request Timeout", "found the body unfinished after 30 s"),
    409: (
        "Its state does not allow this.",
        "state",
        "Conflict",
        "found j20260101-000000-00000000 done, expected it queued or running",
    ),
    412: (
        "It is no longer what the client saw.",
        "precondition",
        "Precondition Failed",
        'found the version "lab3x3-4" in use, expected "lab3x3-3"; look again before you change it',
    ),
    413: (
        "The body is too long.",
        "too-large",
        "Content Too Large",
        "found a body of 2000000 bytes, expected at most 1048576",
    ),
    422: (
        "The request does not fit.",
        "invalid-request",
        "Unprocessable Content",
        "query.limit: found '0'; Input should be greater than or equal to 1",
    ),
    428: (
        "The request does not say what it changes.",
        "precondition-required",
        "Precondition Required",
        "found no If-Match, expected the ETag of what is to be changed",
    ),
    429: (
        "The client asks too often; Retry-After says when it may again.",
        "busy-client",
        "Too Many Requests",
        "found too many requests of one client, expected fewer; ask again in 1 s",
    ),
    503: (
        "The service cannot work now.",
        "database",
        "Service Unavailable",
        "the database refused: database is locked",
    ),
    507: ("The disk is full.", "disk-full", "Insufficient Storage", "No space left for the database; free some"),
}


def describe(app: FastAPI) -> None:
    """Let `app` answer /openapi.json with the whole contract; the document is made once, on the first request."""

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = get_openapi(title=app.title, version=app.version, routes=app.routes)
            _complete(document)
            app.openapi_schema = document
        return app.openapi_schema

    app.openapi = openapi


def _complete(document: dict[str, Any]) -> None:
    components = document.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    for name in ("HTTPValidationError", "ValidationError"):  # the framework's own refusals are answered as ours
        schemas.pop(name, None)
    schemas["Problem"] = PROBLEM
    components["securitySchemes"] = {
        "token": {
            "type": "http",
            "scheme": "bearer",
            "description": "Of `spike4dgs token add`, where the service has tokens. Viewers read, operators do all.",
        }
    }
    for path, item in document["paths"].items():
        for method in _METHODS:
            if method in item:
                _operation(path, method, item[method])


def _operation(path: str, method: str, operation: dict[str, Any]) -> None:
    if is_guarded(path):
        operation["security"] = [{"token": []}, {}]
    for status in _statuses(path, method, operation):
        known = operation["responses"].get(str(status), {}).get("content", {})
        if status != 422 and known:
            continue
        operation["responses"][str(status)] = _refusal(status)


def _statuses(path: str, method: str, operation: dict[str, Any]) -> Iterator[int]:
    yield from (403, 429)
    if is_guarded(path):
        yield from (401, 503)
    if "{" in path:
        yield from (404, 409)
    if "{" in path or operation.get("parameters") or "requestBody" in operation:
        yield 422
    if any(parameter["name"].lower() == "if-match" for parameter in operation.get("parameters", ())):
        yield from (412, 428)
    if method not in ("get", "head"):
        yield from (400, 408, 409, 413, 507)


def _refusal(status: int) -> dict[str, Any]:
    when, kind, title, detail = REFUSALS[status]
    example = {"type": f"urn:spike4dgs:{kind}", "title": title, "status": status, "detail": detail}
    content = {_MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}, "example": example}}
    described: dict[str, Any] = {"description": when, "content": content}
    if status == 429:
        described["headers"] = {"Retry-After": {"schema": {"type": "integer", "minimum": 1}}}
    if status == 401:
        described["headers"] = {"WWW-Authenticate": {"schema": {"type": "string"}}}
    return described
