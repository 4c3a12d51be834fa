"""Counts and times every request."""

import time

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.services.metrics import Metrics


class Measured:
    """Middleware: counts requests by method, route and status, and times them up to the head of the answer."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on and note its answer."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()

        async def watched(message: Message) -> None:
            if message["type"] == "http.response.start":
                # Never the path itself: each path that anyone asks for would become a series of its own.
                route = getattr(scope.get("route"), "path", "none")
                if scope["path"].startswith("/v1/") and route.startswith("/") and not route.startswith("/v1/"):
                    route = f"/v1{route}"  # the framework leaves out the prefix of the routers
                method = scope["method"] if scope["method"] in _METHODS else "other"
                self._metrics.request(method, route, message["status"], time.perf_counter() - began)
            await send(message)

        await self._app(scope, receive, watched)


_METHODS = frozenset(("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"))
