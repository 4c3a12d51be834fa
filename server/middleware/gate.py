"""Who comes in: requests are counted, and those of the interface need a token where there is one."""

from __future__ import annotations

from typing import cast

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send

from server.errors import BusyClientError, ServiceError, UnauthorizedError
from server.middleware.limits import ClientRates, address_of
from server.middleware.problems import problem, problem_of
from server.services.access import AccessService
from server.settings import ServiceSettings
from server.store.tokens import Token

OPEN = ("/v1/healthz",)  # what watches a service has no token


class Gate:
    """Middleware: 401 and 403 by token, 429 by client. The page's files are open, all that they ask for is not."""

    def __init__(self, app: ASGIApp, access: AccessService, settings: ServiceSettings) -> None:
        self._app = app
        self._access = access
        self._rates = ClientRates(settings)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or answer."""
        if scope["type"] not in ("http", "websocket"):
            return await self._app(scope, receive, send)
        try:
            token = await self._admit(scope)
        except SQLAlchemyError as error:
            reason = str(getattr(error, "orig", error)).splitlines()[0]
            answer = problem(503, f"the database refused: {reason[:200]}", "database")
        except ServiceError as error:
            answer = problem_of(error)
            answer.headers.update(_headers_of(error))
        else:
            HTTPConnection(scope).state.token = token
            return await self._app(scope, receive, send)
        return await answer(scope, receive, send)

    async def _admit(self, scope: Scope) -> Token | None:
        method = cast(str, scope.get("method", "GET"))
        token: Token | None = None
        try:
            if is_guarded(scope["path"]):
                if self._access.stale:
                    await run_in_threadpool(self._access.refresh)
                token = self._access.admit(method, Headers(scope=scope).get("authorization"))
        finally:  # who is not let in is counted too
            self._rates.check(f"token {token.id}" if token else address_of(scope), method)
        return token


def is_guarded(path: str) -> bool:
    """Whether a path is one of the interface's."""
    return path.startswith(("/v1", "/metrics")) and path not in OPEN


def _headers_of(error: ServiceError) -> dict[str, str]:
    if isinstance(error, BusyClientError):
        return {"Retry-After": str(error.wait_s)}
    return {"WWW-Authenticate": 'Bearer realm="spike4dgs"'} if isinstance(error, UnauthorizedError) else {}
