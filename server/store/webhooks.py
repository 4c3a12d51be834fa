"""Who wants to be told of what."""

from __future__ import annotations

import base64
import secrets
from dataclasses import dataclass

import sqlalchemy as sa

from server.errors import NotFoundError
from server.store.entries import now
from server.store.tables import deliveries, webhooks


@dataclass(frozen=True)
class Webhook:
    """An address that is told when entries get one of `statuses`; what it is sent is signed with `secret`."""

    id: str
    created: str
    url: str
    secret: str
    statuses: list[str]


class Webhooks:
    """The table of webhooks."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def add(self, url: str, statuses: list[str]) -> Webhook:
        """Keep a new webhook with a new secret."""
        secret = f"whsec_{base64.b64encode(secrets.token_bytes(32)).decode()}"
        made = Webhook(f"w{secrets.token_hex(8)}", now().isoformat("T", "milliseconds"), url, secret, statuses)
        with self._engine.begin() as connection:
            connection.execute(webhooks.insert(), vars(made))
        return made

    def all(self) -> list[Webhook]:
        """All webhooks, oldest first."""
        with self._engine.connect() as connection:
            query = sa.select(webhooks).order_by(webhooks.c.created, webhooks.c.id)
            return [Webhook(**row) for row in connection.execute(query).mappings()]

    def get(self, webhook_id: str) -> Webhook:
        """One webhook; raises NotFoundError."""
        found = [one for one in self.all() if one.id == webhook_id]
        if not found:
            raise NotFoundError(f"found no webhook {webhook_id[:60]}", "one that GET /v1/webhooks lists")
        return found[0]

    def remove(self, webhook_id: str) -> None:
        """Forget a webhook and what it is still owed; raises NotFoundError."""
        self.get(webhook_id)
        with self._engine.begin() as connection:
            connection.execute(deliveries.delete().where(deliveries.c.webhook == webhook_id))
            connection.execute(webhooks.delete().where(webhooks.c.id == webhook_id))
