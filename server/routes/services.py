"""How a route reaches the services, and the parameters that several routes take."""

from typing import Annotated

from fastapi import Depends, Header, Query, Request

from server.schemas.captures import SHOWN
from server.services.services import Services


async def _services(request: Request) -> Services:  # a plain function would cost every request a turn of a thread
    return request.app.state.services


TheServices = Annotated[Services, Depends(_services)]
IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=200,
        pattern="^[!-~]+$",
        description="Sent again, it makes nothing twice.",
    ),
]
Limit = Annotated[int, Query(ge=1, le=1000, description="Entries of a page.")]
Cursor = Annotated[str | None, Query(pattern="^[!-~]{1,40}$", description="`next` of the page before.")]
Word = Annotated[str | None, Query(pattern="^[!-~]{1,80}$")]  # an id or a type, to list what has it
Named = Annotated[str | None, Query(min_length=1, max_length=80, pattern=SHOWN)]
