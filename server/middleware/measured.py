"""Counts and times every request."""

import time
from dataclasses import dataclass

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.services.metrics import Metrics

_METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")


@dataclass
class Measured:
    """Middleware: counts requests by method, route and status, and times them up to the head of the answer."""

    app: ASGIApp
    metrics: Metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on and note its answer."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        began = time.perf_counter()

        async def watched(message: Message) -> None:
            if message["type"] == "http.response.start":
                # Never the path itself: each path that anyone asks for would become a series of its own.
                route = getattr(scope.get("route"), "path", "none")
                if scope["path"].startswith("/v1/") and route.startswith("/") and not route.startswith("/v1/"):
                    route = f"/v1{route}"  # the framework leaves out the prefix of the routers
                method = scope["method"] if scope["method"] in _METHODS else "other"
                self.metrics.request(method, route, message["status"], time.perf_counter() - began)
            await send(message)

        await self.app(scope, receive, watched)
