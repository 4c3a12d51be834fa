"""Webhooks and the messages owed to them: noted with the event itself, so that no crash comes in between."""

import base64
import json
import re
import secrets

import sqlalchemy as sa

from server.errors import NotFoundError
from server.store.records import Records, iso
from server.store.tables import Delivery, Event, StoredWebhook, deliveries, entries, webhooks

LEASE_S = 60.0  # after which another process may try what one that died was sending
KEPT_S = 7 * 24 * 3600.0
_ID = re.compile(r"w[0-9a-f]{16}")


class Webhooks(Records[StoredWebhook]):
    """The table of webhooks."""

    table, row = webhooks, StoredWebhook

    @staticmethod
    def new_id() -> str:
        """Return an id that nobody has."""
        return f"w{secrets.token_hex(8)}"

    def add(self, url: str, statuses: list[str], webhook_id: str | None = None) -> StoredWebhook:
        """Keep a new webhook with a new secret."""
        secret = f"whsec_{base64.b64encode(secrets.token_bytes(32)).decode()}"
        made = StoredWebhook(webhook_id or self.new_id(), self.now(), url, secret, statuses)
        self.insert(made)
        return made

    def all(self) -> list[StoredWebhook]:
        """Return all webhooks, oldest first."""
        return sorted(self.select(), key=lambda one: (one.created, one.id))

    def get(self, webhook_id: str) -> StoredWebhook:
        """Return one webhook; raises NotFoundError."""
        found = self.find(webhook_id)
        if found is None:
            raise NotFoundError(f"found no webhook {webhook_id[:60]}", "one that GET /v1/webhooks lists")
        return found

    def find(self, webhook_id: str) -> StoredWebhook | None:
        """Return one webhook, if it is there."""
        found = self.select(webhooks.c.id == webhook_id) if _ID.fullmatch(webhook_id) else []
        return next(iter(found), None)

    def remove(self, webhook_id: str) -> None:
        """Forget a webhook and what it is still owed; raises NotFoundError."""
        self.get(webhook_id)
        with self._engine.begin() as connection:
            connection.execute(deliveries.delete().where(deliveries.c.webhook == webhook_id))
            connection.execute(webhooks.delete().where(webhooks.c.id == webhook_id))


class Deliveries(Records[Delivery]):
    """The table of deliveries."""

    table, row = deliveries, Delivery

    def claim(self, most: int) -> list[Delivery]:
        """Take what is due, oldest first: it is nobody else's for a minute, and is due again where its taker dies."""
        due = sa.and_(deliveries.c.status == "waiting", deliveries.c.next <= self._clock())
        if not self.select(due, limit=1):  # most often there is nothing, and nobody is locked out
            return []
        with self.writing() as connection:
            found = self.rows(connection, due, order=deliveries.c.event, limit=most)
            for one in found:
                later = {"next": self._clock() + LEASE_S, "attempts": one.attempts + 1}
                connection.execute(deliveries.update().where(_is(one)).values(later))
        return found

    def settle(self, delivery: Delivery, status: str, next_s: float, said: str) -> None:
        """Note how an attempt went; what is waiting is due again in `next_s` seconds."""
        self.update(_is(delivery), status=status, next=self._clock() + next_s, said=said[:200])

    def of(self, webhook_id: str, limit: int) -> list[Delivery]:
        """Return the newest deliveries to a webhook."""
        return self.select(deliveries.c.webhook == webhook_id, order=deliveries.c.event.desc(), limit=limit)

    def prune(self) -> None:
        """Forget deliveries that ended over a week ago."""
        self.delete(deliveries.c.status != "waiting", deliveries.c.next < self._clock() - KEPT_S)


def owe(connection: sa.Connection, event: Event) -> None:
    """Note an event for every webhook that wants it, in the transaction that adds the event."""
    wanting = [
        row.id
        for row in connection.execute(sa.select(webhooks.c.id, webhooks.c.statuses))
        if event.data["status"] in row.statuses
    ]
    if not wanting:
        return
    entry = connection.execute(sa.select(entries).where(entries.c.id == event.entry)).one()
    document = {
        "type": f"{entry.kind}.{event.data['status']}",
        "timestamp": iso(event.at),
        "data": {"seq": event.seq, "id": entry.id, "name": entry.name, "work": entry.type, **event.data},
    }
    body = json.dumps(document)
    rows = [Delivery(webhook, event.seq, body, 0, event.at, "waiting", "") for webhook in wanting]
    connection.execute(deliveries.insert(), [vars(row) for row in rows])


def _is(delivery: Delivery) -> sa.ColumnElement[bool]:
    return sa.and_(deliveries.c.webhook == delivery.webhook, deliveries.c.event == delivery.event)
