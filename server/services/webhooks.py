"""Webhooks, and the delivery of their messages: signed, at least once, and again until one is accepted."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from datetime import UTC, datetime

import httpx
from standardwebhooks.webhooks import Webhook as Signer

from server.errors import NotFoundError, TargetError
from server.schemas.webhooks import Deliveries, Delivery, NewWebhook, Trial, Webhook, WebhookRequest, Webhooks
from server.services.repeated import Repeated
from server.services.targets import addresses_of, allowed_address, target_of
from server.store.records import iso
from server.store.store import Store
from server.store.tables import Delivery as Owed
from server.store.tables import StoredWebhook

BACKOFF_S = (5.0, 30.0, 120.0, 600.0, 3600.0, 4 * 3600.0, 12 * 3600.0)
_TIMEOUT_S = 10.0
_TOGETHER = 20
_LOOK_S = 1.0
_GONE = 410


class WebhookService:
    """The webhooks of a service, and a thread that delivers; several web processes share the work.

    Methods that take an id raise NotFoundError for an unknown one.
    """

    def __init__(
        self,
        store: Store,
        hosts: tuple[str, ...],
        resolve: Callable[..., list[str]] = addresses_of,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._store = store
        self._hosts = hosts
        self._resolve = resolve
        self._clock = clock
        self.thread = Repeated("webhooks", lambda: self.look() == _TOGETHER, _LOOK_S)

    def add(self, request: WebhookRequest, key: str | None = None) -> NewWebhook:
        """Keep a new webhook; return it with its secret.

        Raises TargetError for an address it may not have, IdempotencyError.
        """
        target = target_of(request.url)
        allowed_address(target, self._resolve(target), self._hosts)
        known, new_id = self._store.webhooks, self._store.webhooks.new_id
        asked = f"webhook {request.model_dump_json()}"
        (webhook_id,) = self._store.idempotency.claim(key, asked, lambda: [new_id()]) if key else (new_id(),)
        made = known.find(webhook_id) or known.add(request.url, list(dict.fromkeys(request.statuses)), webhook_id)
        return NewWebhook.model_validate(vars(made))

    def list(self) -> Webhooks:
        """Return all webhooks."""
        return Webhooks(items=[Webhook.model_validate(vars(one)) for one in self._store.webhooks.all()])

    def get(self, webhook_id: str) -> Webhook:
        """Return one webhook."""
        return Webhook.model_validate(vars(self._store.webhooks.get(webhook_id)))

    def remove(self, webhook_id: str) -> None:
        """Forget a webhook."""
        self._store.webhooks.remove(webhook_id)

    def deliveries(self, webhook_id: str, limit: int) -> Deliveries:
        """Return the newest deliveries to a webhook."""
        self._store.webhooks.get(webhook_id)
        return Deliveries(items=[self._delivery(one) for one in self._store.deliveries.of(webhook_id, limit)])

    def test(self, webhook_id: str) -> Trial:
        """Send a message of type `test` now, once."""
        webhook = self._store.webhooks.get(webhook_id)
        at = self._clock()
        body = json.dumps({"type": "test", "timestamp": iso(at), "data": {}})
        ok, said, _ = asyncio.run(self._send(webhook, f"msg_{webhook.id}_test_{int(at * 1000)}", body))
        return Trial(ok=ok, said=said)

    def look(self) -> int:
        """Try what is due; return how many deliveries that were."""
        due = self._store.deliveries.claim(_TOGETHER)
        if due:
            asyncio.run(self._deliver(due))
        return len(due)

    def _delivery(self, owed: Owed) -> Delivery:
        due_in_s = max(0.0, owed.next - self._store.clock()) if owed.status == "waiting" else None
        return Delivery.model_validate(vars(owed) | {"due_in_s": due_in_s})

    async def _deliver(self, due: list[Owed]) -> None:
        await asyncio.gather(*(self._attempt(one) for one in due))

    async def _attempt(self, delivery: Owed) -> None:
        try:
            webhook = await asyncio.to_thread(self._store.webhooks.get, delivery.webhook)
        except NotFoundError:  # deleted meanwhile, and the delivery with it
            return
        ok, said, for_ever = await self._send(webhook, f"msg_{webhook.id}_{delivery.event}", delivery.body)
        again = delivery.attempts < len(BACKOFF_S) and not for_ever
        status = "delivered" if ok else "waiting" if again else "failed"
        wait_s = BACKOFF_S[delivery.attempts] if status == "waiting" else 0.0
        await asyncio.to_thread(self._store.deliveries.settle, delivery, status, wait_s, said)

    async def _send(self, webhook: StoredWebhook, message_id: str, body: str) -> tuple[bool, str, bool]:
        """Send a message; return whether it was accepted, the answer, and whether not to try again."""
        try:
            async with asyncio.timeout(_TIMEOUT_S):
                status = await self._post(webhook, message_id, body)
        except TimeoutError:
            return False, f"found no answer in {_TIMEOUT_S:g} s", False
        except (TargetError, httpx.HTTPError, OSError) as error:
            return False, " ".join(str(error).split()) or type(error).__name__, False
        return 200 <= status < 300, f"HTTP {status}", status == _GONE

    async def _post(self, webhook: StoredWebhook, message_id: str, body: str) -> int:
        """Post a message and return the status of the answer; the name is resolved once, and that address used."""
        target = target_of(webhook.url)
        address = allowed_address(target, await asyncio.to_thread(self._resolve, target), self._hosts)
        at = int(self._clock())
        headers = {
            "Host": target.authority,
            "Content-Type": "application/json",
            "User-Agent": "spike4dgs",
            "webhook-id": message_id,
            "webhook-timestamp": str(at),
            "webhook-signature": Signer(webhook.secret).sign(message_id, datetime.fromtimestamp(at, UTC), body),
        }
        extensions = {"sni_hostname": target.host} if target.scheme == "https" else {}
        async with httpx.AsyncClient(timeout=_TIMEOUT_S, trust_env=False, follow_redirects=False) as client:
            request = client.build_request(
                "POST", target.at(address), content=body, headers=headers, extensions=extensions
            )
            answer = await client.send(request, stream=True)
            await answer.aclose()
            return answer.status_code
