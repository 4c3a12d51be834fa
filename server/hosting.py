"""The web server, which waits for requests under way when it stops, but not for streams that have no end."""

import asyncio
import socket
from typing import Any

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.auto import AutoHTTPProtocol

from server.settings import ServiceSettings
from server.telemetry import configure_logs

_PATIENCE_S = 10  # for downloads
_HEADERS_S = 10.0  # for the head of a request
_MOST_CONNECTIONS = 1000
_NEW = object()


class _Protocol(AutoHTTPProtocol):
    """Closes a connection whose client does not send the head of a request: the server alone would wait for ever."""

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._look(transport, _NEW)

    def _look(self, transport: asyncio.Transport, last: object) -> None:
        """Close the connection if no request has come since `last` was answered, and look again later."""
        if transport.is_closing():
            return
        cycle: Any = getattr(self, "cycle", None)  # of the request under way or answered last
        if cycle is last and (cycle is None or cycle.response_complete):
            transport.close()
        else:
            asyncio.get_running_loop().call_later(_HEADERS_S, self._look, transport, cycle)


class _Server(uvicorn.Server):
    def __init__(self, app: FastAPI, settings: ServiceSettings) -> None:
        text = settings.log == "text"
        config = uvicorn.Config(
            app,
            log_level="warning" if text else None,
            access_log=not text,
            server_header=False,
            http=_Protocol,
            limit_concurrency=_MOST_CONNECTIONS,
            timeout_graceful_shutdown=_PATIENCE_S,
        )
        super().__init__(config)
        configure_logs(settings)  # after uvicorn has set up its own
        self._app = app

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Tell the worker to stop and end the streams, then everything: all of it together is given 30 s."""
        self._app.state.services.begin_close()
        await super().shutdown(sockets)


def server_of(app: FastAPI, settings: ServiceSettings) -> uvicorn.Server:
    """Return a server of the service's application, with its logs set up."""
    return _Server(app, settings)
