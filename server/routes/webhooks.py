"""Webhooks: addresses that are told when captures and jobs change."""

from typing import Annotated

from fastapi import APIRouter, Query, Response

from server.routes.parameters import TheServices, located
from server.schemas.webhooks import Deliveries, NewWebhook, Trial, Webhook, WebhookRequest, Webhooks

router = APIRouter(prefix="/webhooks", tags=["webhooks"])


@router.post("", status_code=201)
def add_webhook(request: WebhookRequest, response: Response, services: TheServices) -> NewWebhook:
    """Add an address to be told, signed as standardwebhooks.com describes; the secret is shown only here."""
    return located(response, "webhooks", services.webhooks.add(request))


@router.get("")
def webhooks(services: TheServices) -> Webhooks:
    """List all webhooks."""
    return services.webhooks.list()


@router.get("/{webhook_id}")
def webhook(webhook_id: str, services: TheServices) -> Webhook:
    """Return one webhook."""
    return services.webhooks.get(webhook_id)


@router.delete("/{webhook_id}", status_code=204)
def delete_webhook(webhook_id: str, services: TheServices) -> None:
    """Remove a webhook, with the messages it has not received yet."""
    services.webhooks.remove(webhook_id)


@router.get("/{webhook_id}/deliveries")
def deliveries(webhook_id: str, services: TheServices, limit: Annotated[int, Query(ge=1, le=1000)] = 100) -> Deliveries:
    """List its messages, sent and still to be sent, newest first."""
    return services.webhooks.deliveries(webhook_id, limit)


@router.post("/{webhook_id}/test")
def try_webhook(webhook_id: str, services: TheServices) -> Trial:
    """Send it one message of type `test` now."""
    return services.webhooks.test(webhook_id)
