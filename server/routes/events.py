"""Events of captures and jobs as they happen (Server-Sent Events)."""

import contextlib
from collections.abc import AsyncGenerator, Callable
from typing import Annotated, Any

import anyio
from fastapi import APIRouter, Header, Query, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse
from starlette.types import Message, Send

from server.routes.parameters import TheServices
from server.services.hub import Hub

router = APIRouter(tags=["events"])
_SEND_S = 10.0  # seconds for one event; a reader who takes longer is gone
_SHOWN: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {"text/event-stream": {"schema": {"$ref": "#/components/schemas/Event"}}},
        "description": "`id` is the number, `data` an Event as JSON.",
    },
    204: {"description": "It has ended and the client has seen every event: an EventSource does not reconnect."},
}

LastEventId = Annotated[
    int | None, Header(alias="Last-Event-ID", ge=0, lt=2**63, description="The last number the client has seen.")
]
After = Annotated[int | None, Query(ge=0, lt=2**63, description="The same, for a client that cannot set the header.")]


class EventStream(StreamingResponse):
    """Streams events, and gives up on a reader who does not read."""

    media_type = "text/event-stream"

    def __init__(self, content: AsyncGenerator[bytes]) -> None:
        super().__init__(content, headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"})
        self._content = content

    async def stream_response(self, send: Send) -> None:
        """Send the pieces, each within its time."""

        async def in_time(message: Message) -> None:
            with anyio.fail_after(_SEND_S):
                await send(message)

        try:
            with contextlib.suppress(TimeoutError):
                await super().stream_response(in_time)
        finally:
            await self._content.aclose()


@router.get("/events", status_code=200, response_class=EventStream, responses={200: _SHOWN[200]})
async def stream_events(services: TheServices, last: LastEventId = None, after: After = None) -> Response:
    """Stream the events of all captures and jobs, from a number on or, without one, from now on."""
    seq = last if last is not None else after
    if seq is None:
        seq = await run_in_threadpool(services.hub.newest)
    return EventStream(services.hub.stream(seq))


@router.get("/jobs/{job_id}/events", status_code=200, response_class=EventStream, responses=_SHOWN)
async def stream_job_events(
    job_id: str, services: TheServices, last: LastEventId = None, after: After = None
) -> Response:
    """Stream the events of one job, from its beginning or from a number on, until it ends."""
    return await _of_entry(services.hub, services.jobs.get, last or after or 0, job_id)


@router.get("/captures/{capture_id}/events", status_code=200, response_class=EventStream, responses=_SHOWN)
async def stream_capture_events(
    capture_id: str, services: TheServices, last: LastEventId = None, after: After = None
) -> Response:
    """Stream the events of one capture, from its beginning or from a number on, until it ends."""
    return await _of_entry(services.hub, services.captures.get, last or after or 0, capture_id)


async def _of_entry(hub: Hub, get: Callable[[str], object], seq: int, entry_id: str) -> Response:
    def over() -> bool:
        get(entry_id)  # raises NotFoundError
        return hub.is_over(seq, entry_id)

    return Response(status_code=204) if await run_in_threadpool(over) else EventStream(hub.stream(seq, entry_id))
