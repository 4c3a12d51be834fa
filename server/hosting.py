"""The web server, which waits for requests under way when it stops, but not for streams that have no end."""

from __future__ import annotations

import socket

import uvicorn
from fastapi import FastAPI

_PATIENCE_S = 10  # for downloads


class _Server(uvicorn.Server):
    def __init__(self, app: FastAPI) -> None:
        super().__init__(uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=_PATIENCE_S))
        self._app = app

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the streams, then everything."""
        self._app.state.services.hub.close()
        await super().shutdown(sockets)


def server_of(app: FastAPI) -> uvicorn.Server:
    """A server of the service's application."""
    return _Server(app)
