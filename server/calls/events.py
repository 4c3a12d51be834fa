"""A client's requests about events and webhooks."""

from collections.abc import Iterator, Sequence

from server.calls.transport import Transport
from server.schemas.progress import ENDED, Event
from server.schemas.webhooks import Deliveries, Delivery, NewWebhook, Trial, Webhook, Webhooks


class EventCalls(Transport):
    """Follows events as they happen, and has webhooks told of them."""

    def job_events(self, job_id: str, after: int = 0) -> Iterator[Event]:
        """Yield the events of a job after number `after`, until it ends."""
        return self._events(f"/jobs/{job_id}/events", after)

    def capture_events(self, capture_id: str, after: int = 0) -> Iterator[Event]:
        """Yield the events of a capture after number `after`, until it ends."""
        return self._events(f"/captures/{capture_id}/events", after)

    def events(self, after: int | None = None) -> Iterator[Event]:
        """Yield the events of all captures and jobs, from now on or after a number, until the service ends."""
        return self._events("/events", after)

    def _events(self, path: str, after: int | None) -> Iterator[Event]:
        headers = {} if after is None else {"Last-Event-ID": str(after)}
        with self._http.stream("GET", f"/v1{path}", headers=headers, timeout=30) as response:
            if response.is_error:
                response.read()
            for line in self._checked(response).iter_lines():  # every event is one line of data
                if line.startswith("data: "):
                    yield Event.model_validate_json(line.removeprefix("data: "))

    def add_webhook(self, url: str, statuses: Sequence[str] = ENDED) -> NewWebhook:
        """Have an address told; only the answer holds the secret."""
        return self._ask(NewWebhook, "POST", "/webhooks", json={"url": url, "statuses": list(statuses)})

    def webhooks(self) -> list[Webhook]:
        """List all webhooks."""
        return self._get("/webhooks", Webhooks).items

    def deliveries(self, webhook_id: str, limit: int = 100) -> list[Delivery]:
        """List the messages of a webhook, sent and still to be sent, newest first."""
        return self._get(f"/webhooks/{webhook_id}/deliveries", Deliveries, limit=limit).items

    def try_webhook(self, webhook_id: str) -> Trial:
        """Send a webhook a test message now."""
        return self._post(f"/webhooks/{webhook_id}/test", Trial)

    def delete_webhook(self, webhook_id: str) -> None:
        """Remove a webhook."""
        self._send("DELETE", f"/webhooks/{webhook_id}")
