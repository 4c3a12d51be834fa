"""What the client asks of events."""

from __future__ import annotations

from collections.abc import Iterator

from server.calls.transport import Transport
from server.schemas.progress import Event


class EventCalls(Transport):
    """What happens, as it happens."""

    def job_events(self, job_id: str, after: int = 0) -> Iterator[Event]:
        """What happens to a job after event number `after`, until it ends."""
        return self._events(f"/jobs/{job_id}/events", after)

    def capture_events(self, capture_id: str, after: int = 0) -> Iterator[Event]:
        """What happens to a capture after event number `after`, until it ends."""
        return self._events(f"/captures/{capture_id}/events", after)

    def events(self, after: int | None = None) -> Iterator[Event]:
        """What happens to all captures and jobs, from now on or after a number, until the service ends."""
        return self._events("/events", after)

    def _events(self, path: str, after: int | None) -> Iterator[Event]:
        headers = {} if after is None else {"Last-Event-ID": str(after)}
        with self._http.stream("GET", f"/v1{path}", headers=headers, timeout=30) as response:
            if response.is_error:
                response.read()
            for line in self._checked(response).iter_lines():  # every event is one line of data
                if line.startswith("data: "):
                    yield Event.model_validate_json(line.removeprefix("data: "))
