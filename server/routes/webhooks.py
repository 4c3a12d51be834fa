"""Webhooks: addresses that are told when captures and jobs change."""

from typing import Annotated
from urllib.parse import urlsplit

from fastapi import APIRouter, Query, Request, Response

from server.routes.parameters import IdempotencyKey, TheServices, located
from server.schemas.webhooks import Deliveries, NewWebhook, Trial, Webhook, WebhookMessage, WebhookRequest, Webhooks
from server.store.tables import Token

router = APIRouter(prefix="/webhooks", tags=["webhooks"])


@router.post("", status_code=201)
def add_webhook(
    request: WebhookRequest, response: Response, services: TheServices, key: IdempotencyKey = None
) -> NewWebhook:
    """Add an address to be told, signed as standardwebhooks.com describes; the secret is shown only here."""
    return located(response, "webhooks", services.webhooks.add(request, key))


@router.get("")
def list_webhooks(request: Request, services: TheServices) -> Webhooks:
    """List all webhooks; a viewer sees their hosts alone."""
    return Webhooks(items=[_shown(one, request) for one in services.webhooks.list().items])


@router.get("/{webhook_id}")
def get_webhook(webhook_id: str, request: Request, services: TheServices) -> Webhook:
    """Return one webhook; a viewer sees its host alone."""
    return _shown(services.webhooks.get(webhook_id), request)


@router.delete("/{webhook_id}", status_code=204)
def delete_webhook(webhook_id: str, services: TheServices) -> None:
    """Remove a webhook, with the messages it has not received yet."""
    services.webhooks.remove(webhook_id)


@router.get("/{webhook_id}/deliveries")
def list_deliveries(
    webhook_id: str, services: TheServices, limit: Annotated[int, Query(ge=1, le=1000)] = 100
) -> Deliveries:
    """List its messages, sent and still to be sent, newest first."""
    return services.webhooks.deliveries(webhook_id, limit)


@router.post("/{webhook_id}/test")
def test_webhook(webhook_id: str, services: TheServices) -> Trial:
    """Send it one message of type `test` now."""
    return services.webhooks.test(webhook_id)


def _shown(webhook: Webhook, request: Request) -> Webhook:
    """Return it as the request's token may see it: whoever knows the whole address may send messages there."""
    token: Token | None = request.state.token
    if token is None or token.role == "operator":
        return webhook
    url = urlsplit(webhook.url)
    return webhook.model_copy(update={"url": f"{url.scheme}://{url.hostname}/..."})


def tell_entry_changed(message: WebhookMessage) -> None:
    """Describe what a webhook receives when a capture or job gets one of its statuses; any 2xx accepts it."""
