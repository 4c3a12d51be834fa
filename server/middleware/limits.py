"""Limits on a body: how large, how slow; and strict JSON, which every reader understands alike."""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.errors import MalformedError, ServiceError, SlowBodyError, TooLargeError
from server.middleware.problems import problem_of
from server.settings import ServiceSettings

_DEEPEST = 32  # levels of nesting
_LONG = 2**14  # bytes of JSON; a longer body is worth a thread of its own


class BodyLimit:
    """Middleware: reads each body whole before the request goes on, and refuses one that is too long or too slow.

    A body whose Content-Length is too large is refused unread. A piece of an upload is written to disk as it arrives:
    it is left to its route, which may wait for each part as long as for a whole body.
    """

    def __init__(self, app: ASGIApp, settings: ServiceSettings) -> None:
        self._app = app
        self._most = settings.body_bytes
        self._patience_s = settings.body_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it with 400, 408 or 413."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
        elif scope["method"] == "PATCH" and scope["path"].startswith("/v1/uploads/"):
            await self._app(scope, _impatient(receive, self._patience_s), send)
        else:
            await self._whole(scope, receive, send)

    async def _whole(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        length = headers.get("content-length", "0")
        try:
            if length.isdecimal() and (len(length) > 20 or int(length) > self._most):
                raise TooLargeError(f"found a body of {length[:20]} bytes", f"at most {self._most}")
            async with _patience(self._patience_s):
                body = await _read(receive, self._most)
            if body and "json" in headers.get("content-type", "").lower():
                if len(body) < _LONG:
                    check_json(body)
                else:
                    await run_in_threadpool(check_json, body)
        except ServiceError as error:
            await problem_of(error)(scope, receive, send)
        else:
            if body is not None:
                await self._app(scope, _again(body, receive), send)


@asynccontextmanager
async def _patience(patience_s: float) -> AsyncIterator[None]:
    """Raise SlowBodyError if what is inside takes longer."""
    try:
        async with asyncio.timeout(patience_s):
            yield
    except TimeoutError as error:
        raise SlowBodyError(f"found the body unfinished after {patience_s:g} s", "all of it") from error


async def _read(receive: Receive, most: int) -> bytes | None:
    """Return the whole body, or None if the client went away."""
    body = bytearray()
    while True:
        message = await receive()
        if message["type"] == "http.disconnect":
            return None
        body += message.get("body", b"")
        if len(body) > most:
            raise TooLargeError(f"found a body of more than {most} bytes", f"at most {most}")
        if not message.get("more_body", False):
            return bytes(body)


def _again(body: bytes, receive: Receive) -> Receive:
    """Return a `receive` that gives the body that was read, then what follows it."""
    kept: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def replay() -> Message:
        return kept.pop() if kept else await receive()

    return replay


def _impatient(receive: Receive, patience_s: float) -> Receive:
    """Return a `receive` that waits `patience_s` for each piece of a body and then raises SlowBodyError."""
    whole = False

    async def hurried() -> Message:
        nonlocal whole
        if whole:
            return await receive()
        async with _patience(patience_s):
            message = await receive()
        whole = not message.get("more_body", False)
        return message

    return hurried


def check_json(body: bytes) -> None:
    """Raise MalformedError for JSON that readers understand differently: a name twice, NaN, values nested too deep.

    Text that is no JSON at all is left to the framework, whose answer tells the line and column.
    """
    try:
        document = json.loads(body, object_pairs_hook=_object, parse_constant=_constant)
    except RecursionError as error:
        raise _too_deep() from error
    except ValueError:
        return
    level = [document]
    for _ in range(_DEEPEST):
        level = [child for item in level for child in _children(item)]
        if not level:
            return
    raise _too_deep()


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    made = dict(pairs)
    if len(made) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in made if names.count(name) > 1)
        raise MalformedError(f"found the member {twice[:60]!r} twice", "it once")
    return made


def _constant(name: str) -> float:
    raise MalformedError(f"found {name}", "a number: JSON has no other")


def _children(item: Any) -> list[Any]:
    if isinstance(item, dict):
        return list(item.values())
    return item if isinstance(item, list) else []


def _too_deep() -> MalformedError:
    return MalformedError(f"found values nested deeper than {_DEEPEST}", "a flat document")
