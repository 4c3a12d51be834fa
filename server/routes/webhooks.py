"""Webhooks: who is told of captures and jobs."""

from typing import Annotated

from fastapi import APIRouter, Query, Response

from server.routes.services import TheServices
from server.schemas.webhooks import Deliveries, NewWebhook, Trial, Webhook, WebhookRequest, Webhooks

router = APIRouter(prefix="/webhooks", tags=["webhooks"])


@router.post("", status_code=201)
def add_webhook(request: WebhookRequest, response: Response, services: TheServices) -> NewWebhook:
    """Be told of captures and jobs at an address, signed as standardwebhooks.com has it; the secret is shown once."""
    made = services.webhooks.add(request)
    response.headers["Location"] = f"/v1/webhooks/{made.id}"
    return made


@router.get("")
def webhooks(services: TheServices) -> Webhooks:
    """All webhooks."""
    return services.webhooks.list()


@router.get("/{webhook_id}")
def webhook(webhook_id: str, services: TheServices) -> Webhook:
    """One webhook."""
    return services.webhooks.get(webhook_id)


@router.delete("/{webhook_id}", status_code=204)
def delete_webhook(webhook_id: str, services: TheServices) -> None:
    """Tell it nothing more, not even what it is still owed."""
    services.webhooks.remove(webhook_id)


@router.get("/{webhook_id}/deliveries")
def deliveries(webhook_id: str, services: TheServices, limit: Annotated[int, Query(ge=1, le=1000)] = 100) -> Deliveries:
    """What it was told and will be, newest first."""
    return services.webhooks.deliveries(webhook_id, limit)


@router.post("/{webhook_id}/test")
def try_webhook(webhook_id: str, services: TheServices) -> Trial:
    """Send it a message of type `test` now, once."""
    return services.webhooks.test(webhook_id)
