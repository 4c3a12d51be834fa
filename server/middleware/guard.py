"""Refuses requests through another host name or from another site's page.

A loopback service needs this: a page elsewhere can point its own host name at 127.0.0.1, or post a form across sites.
"""

import re
from collections.abc import Sequence
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from server.errors import ForeignRequestError
from server.middleware.problems import problem_of

_HOSTS = ("127.0.0.1", "localhost", "::1")


class LoopbackGuard:
    """Middleware: Host must be a loopback name or one of `hosts`, Origin this very service or one of `origins`."""

    def __init__(self, app: ASGIApp, hosts: Sequence[str] = (), origins: Sequence[str] = ()) -> None:
        self._app = app
        self._hosts = (*_HOSTS, *hosts)
        self._origins = origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it with 403."""
        fault = self._fault(scope) if scope["type"] in ("http", "websocket") else None
        if fault is None:
            await self._app(scope, receive, send)
        else:
            await problem_of(fault)(scope, receive, send)

    def _fault(self, scope: Scope) -> ForeignRequestError | None:
        headers = Headers(scope=scope)
        hosts, origins = headers.getlist("host"), headers.getlist("origin")
        host = hosts[0].lower() if len(hosts) == 1 else ""
        if _name_of(host) not in self._hosts and host not in self._hosts:
            return ForeignRequestError(f"found the host {host[:60]!r}", f"one of {', '.join(self._hosts)}")
        own = f"{'https' if scope['scheme'] in ('https', 'wss') else 'http'}://{host}"
        for origin in origins:
            if origin.lower() != own and origin.lower() not in self._origins:
                return ForeignRequestError(f"found a request from the page {origin[:60]!r}", f"one from {own}")
        return None


def _name_of(host: str) -> str | None:
    """Return the name in a Host header without its port, or None if it has none."""
    if re.search(r"[/?#@\\\s]", host):
        return None
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None
