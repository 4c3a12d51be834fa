"""The gate: counts each client's requests, and asks for a token where the service has any."""

import ipaddress
import math
import time
from collections.abc import Callable
from typing import cast

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send

from server.errors import BusyClientError, ServiceError
from server.middleware.problems import problem_of
from server.services.access import AccessService
from server.settings import ServiceSettings
from server.store.tables import Token

_MOST_CLIENTS = 10_000
_READS = ("GET", "HEAD", "OPTIONS")
OPEN = ("/v1/healthz",)  # a watchdog of the service has no token
READY = "/v1/readyz"  # nor has one of its work, which is told whether it is ready and no more


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


class Gate:
    """Middleware: 401 and 403 by token, 429 by client. The page's files are open; all that they ask for is not."""

    def __init__(self, app: ASGIApp, access: AccessService, settings: ServiceSettings) -> None:
        self._app = app
        self._access = access
        self._reads = Rates(settings.read_rate, settings.read_burst)
        self._writes = Rates(settings.write_rate, settings.write_burst)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it."""
        if scope["type"] in ("http", "websocket"):
            try:
                HTTPConnection(scope).state.token = await self._admit(scope)
            except (SQLAlchemyError, ServiceError) as error:
                return await problem_of(error)(scope, receive, send)
        return await self._app(scope, receive, send)

    async def _admit(self, scope: Scope) -> Token | None:
        method = cast(str, scope.get("method", "GET"))
        token: Token | None = None
        try:
            if is_guarded(scope["path"]):
                if self._access.stale:
                    await run_in_threadpool(self._access.refresh)
                given = Headers(scope=scope).get("authorization")
                if given is not None or scope["path"] != READY:
                    token = self._access.admit(method, given)
        finally:  # a refused request counts too
            rates = self._reads if method in _READS else self._writes
            if wait_s := rates.wait_s(f"token {token.id}" if token else address_of(scope)):
                raise BusyClientError(math.ceil(wait_s))
        return token


def is_guarded(path: str) -> bool:
    """Tell whether a path is one of the interface's."""
    return path.startswith(("/v1", "/metrics")) and path not in OPEN
