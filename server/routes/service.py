"""How a route reaches the service."""

from typing import Annotated

from fastapi import Depends, Request

from server.service import Service


def _service(request: Request) -> Service:
    return request.app.state.service


TheService = Annotated[Service, Depends(_service)]
