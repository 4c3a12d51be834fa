"""What the client asks of webhooks."""

from __future__ import annotations

from collections.abc import Sequence

from server.calls.transport import Transport
from server.schemas.webhooks import Deliveries, Delivery, NewWebhook, Trial, Webhook, Webhooks


class WebhookCalls(Transport):
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
