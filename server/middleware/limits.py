"""Limits on one client: how many requests, how large, how slow."""

import asyncio
import ipaddress
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.errors import ServiceError, SlowBodyError, TooLargeError
from server.middleware.problems import problem_of
from server.middleware.strict import check_json
from server.settings import ServiceSettings

_MOST_CLIENTS = 10_000


class Rates:
    """Keeps a token bucket for each client: `burst` requests at once, then `rate` a second.

    Memory is bounded: the client that has been quiet longest is forgotten first.
    """

    def __init__(self, rate: float, burst: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate = rate
        self._burst = burst
        self._clock = clock
        self._buckets: dict[str, tuple[float, float]] = {}  # requests left at a time; the quietest client is first

    def wait_s(self, client: str) -> float:
        """Count a request and return 0, or return the seconds until the client may ask again."""
        now = self._clock()
        left, at = self._buckets.pop(client, (self._burst, now))
        left = min(self._burst, left + (now - at) * self._rate)
        self._buckets[client] = (left - 1 if left >= 1 else left, now)
        if len(self._buckets) > _MOST_CLIENTS:
            del self._buckets[next(iter(self._buckets))]
        return max(0.0, (1 - left) / self._rate)


def address_of(scope: Scope) -> str:
    """Return who counts as one client: an IPv4 address, or the /64 network of an IPv6 host."""
    host = (scope.get("client") or ("unknown", 0))[0]
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    return host if address.version == 4 else str(ipaddress.ip_network((int(address) >> 64 << 64, 64)))


class BodyLimit:
    """Middleware: reads each body whole before the request goes on, and refuses one that is too long or too slow.

    A body whose Content-Length is too large is refused unread. A streamed body is left to its route, which may wait for
    each piece as long as for a whole body.
    """

    def __init__(self, app: ASGIApp, settings: ServiceSettings) -> None:
        self._app = app
        self._most = settings.body_bytes
        self._patience_s = settings.body_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it with 400, 408 or 413."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
        elif is_streamed(scope):
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
                await check_json(body)
        except ServiceError as error:
            await problem_of(error)(scope, receive, send)
        else:
            if body is not None:
                await self._app(scope, _again(body, receive), send)


def is_streamed(scope: Scope) -> bool:
    """Tell whether the body is a piece of an upload, which is written to disk as it arrives."""
    return scope["method"] == "PATCH" and scope["path"].startswith("/v1/uploads/")


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
