"""Refuses requests that come through another host name or from another site's page.

A loopback service is open to both: a page elsewhere can point its own name at 127.0.0.1, or post a form across sites.
"""

from __future__ import annotations

from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from server.errors import ForeignRequestError, problem_of

_HOSTS = ("127.0.0.1", "localhost", "::1")


class LoopbackGuard:
    """Middleware: the Host must be a loopback name, and an Origin must be this very service."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or answer 403."""
        fault = _fault(Headers(scope=scope)) if scope["type"] in ("http", "websocket") else None
        if fault is None:
            await self._app(scope, receive, send)
        else:
            await problem_of(ForeignRequestError(fault))(scope, receive, send)


def _fault(headers: Headers) -> str | None:
    host, origin = headers.get("host", ""), headers.get("origin")
    try:
        name = urlsplit(f"//{host}").hostname
    except ValueError:
        name = None
    if name not in _HOSTS:
        return f"found the host {host[:60]!r}, expected one of {', '.join(_HOSTS)}"
    if origin is not None and origin != f"http://{host}":
        return f"found a request from the page {origin[:60]!r}, expected one from http://{host}"
    return None
