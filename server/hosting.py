"""The web server, which waits for requests under way when it stops, but not for streams that have no end."""

import socket

import uvicorn
from fastapi import FastAPI

from server.settings import ServiceSettings
from server.telemetry import configure_logs

_PATIENCE_S = 10  # for downloads


class _Server(uvicorn.Server):
    def __init__(self, app: FastAPI, settings: ServiceSettings) -> None:
        text = settings.log == "text"
        config = uvicorn.Config(
            app,
            log_level="warning" if text else None,
            access_log=not text,
            server_header=False,
            timeout_graceful_shutdown=_PATIENCE_S,
        )
        super().__init__(config)
        configure_logs(settings)  # after uvicorn has set up its own
        self._app = app

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the streams, then everything."""
        self._app.state.services.hub.close()
        await super().shutdown(sockets)


def server_of(app: FastAPI, settings: ServiceSettings) -> uvicorn.Server:
    """Return a server of the service's application, with its logs set up."""
    return _Server(app, settings)
