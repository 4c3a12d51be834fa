"""How the client asks, and what it asks of events and webhooks."""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Sequence
from typing import TypeVar

import httpx
from pydantic import BaseModel

from server.errors import ServiceError
from server.schemas.progress import Event
from server.schemas.webhooks import Deliveries, Delivery, NewWebhook, Trial, Webhook, Webhooks

_M = TypeVar("_M", bound=BaseModel)


class RefusedError(ServiceError):
    """The service answered with a problem; the message is its detail."""

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.status = status
        self.exit_code = 2 if 400 <= status < 500 else 1


class Calls:
    """Sends requests under /v1; raises RefusedError for a problem and httpx.TransportError where nothing answers."""

    def __init__(self, http: httpx.Client) -> None:
        self._http = http

    def _get(self, path: str, model: type[_M], **parameters: str | int) -> _M:
        return model.model_validate_json(self._checked(self._http.get(f"/v1{path}", params=parameters)).content)

    def _post(self, path: str, model: type[_M], request: BaseModel | None = None) -> _M:
        body = None if request is None else request.model_dump(exclude_none=True)
        headers = {"Idempotency-Key": uuid.uuid4().hex}  # a transport may send again what got no answer
        return model.model_validate_json(
            self._checked(self._http.post(f"/v1{path}", json=body, headers=headers)).content
        )

    @staticmethod
    def _checked(response: httpx.Response) -> httpx.Response:
        if response.is_error:
            raise RefusedError(response.status_code, response.json()["detail"])
        return response


class EventCalls(Calls):
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


class WebhookCalls(Calls):
    """Who is told."""

    def add_webhook(self, url: str, statuses: Sequence[str] = ("done", "failed", "cancelled")) -> NewWebhook:
        """Have an address told; the answer alone holds the secret."""
        body = {"url": url, "statuses": list(statuses)}
        return NewWebhook.model_validate_json(self._checked(self._http.post("/v1/webhooks", json=body)).content)

    def webhooks(self) -> list[Webhook]:
        """All webhooks."""
        return self._get("/webhooks", Webhooks).items

    def deliveries(self, webhook_id: str, limit: int = 100) -> list[Delivery]:
        """What a webhook was told and will be, newest first."""
        return self._get(f"/webhooks/{webhook_id}/deliveries", Deliveries, limit=limit).items

    def try_webhook(self, webhook_id: str) -> Trial:
        """Send it a test now."""
        return self._post(f"/webhooks/{webhook_id}/test", Trial)

    def delete_webhook(self, webhook_id: str) -> None:
        """Tell it nothing more."""
        self._checked(self._http.delete(f"/v1/webhooks/{webhook_id}"))
