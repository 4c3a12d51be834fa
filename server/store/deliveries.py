"""What is owed to webhooks: noted with the event itself, so that no crash comes in between."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa

from server.store.database import lock_writers
from server.store.event import Event
from server.store.tables import deliveries, entries, webhooks

LEASE_S = 60.0  # after that another process may try what one that died was sending
KEPT_S = 7 * 24 * 3600.0


@dataclass(frozen=True)
class Delivery:
    """An event on its way to a webhook; `next` is when it is due or, once it is over, when it ended."""

    webhook: str
    event: int
    body: str
    attempts: int
    next: float
    status: str
    said: str


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
        "timestamp": datetime.fromtimestamp(event.at, UTC).isoformat("T", "milliseconds"),
        "data": {"seq": event.seq, "id": entry.id, "name": entry.name, "work": entry.type, **event.data},
    }
    row: dict[str, Any] = {"event": event.seq, "body": json.dumps(document), "attempts": 0, "next": event.at}
    rows = [row | {"webhook": webhook, "status": "waiting", "said": ""} for webhook in wanting]
    connection.execute(deliveries.insert(), rows)


class Deliveries:
    """The table of deliveries."""

    def __init__(self, engine: sa.Engine, clock: Callable[[], float] = time.time) -> None:
        self._engine = engine
        self._clock = clock

    def claim(self, most: int) -> list[Delivery]:
        """Take what is due, oldest first: it is nobody else's for a minute, and is due again where its taker dies."""
        due = sa.and_(deliveries.c.status == "waiting", deliveries.c.next <= self._clock())
        with self._engine.connect() as connection:  # most often there is nothing, and nobody to be locked out
            if connection.execute(sa.select(deliveries.c.event).where(due).limit(1)).first() is None:
                return []
        with self._engine.begin() as connection:
            lock_writers(connection)
            query = sa.select(deliveries).where(due).order_by(deliveries.c.event).limit(most)
            found = [Delivery(**row) for row in connection.execute(query).mappings()]
            for one in found:
                later = {"next": self._clock() + LEASE_S, "attempts": one.attempts + 1}
                connection.execute(deliveries.update().where(_is(one)).values(later))
        return found

    def settle(self, delivery: Delivery, status: str, next_s: float, said: str) -> None:
        """Note how an attempt went; what is waiting is due again in `next_s` seconds."""
        with self._engine.begin() as connection:
            values = {"status": status, "next": self._clock() + next_s, "said": said[:200]}
            connection.execute(deliveries.update().where(_is(delivery)).values(values))

    def of(self, webhook_id: str, limit: int) -> list[Delivery]:
        """The newest deliveries to a webhook."""
        mine = deliveries.c.webhook == webhook_id
        query = sa.select(deliveries).where(mine).order_by(deliveries.c.event.desc()).limit(limit)
        with self._engine.connect() as connection:
            return [Delivery(**row) for row in connection.execute(query).mappings()]

    def prune(self) -> None:
        """Forget deliveries that were over a week ago."""
        old = sa.and_(deliveries.c.status != "waiting", deliveries.c.next < self._clock() - KEPT_S)
        with self._engine.begin() as connection:
            connection.execute(deliveries.delete().where(old))


def _is(delivery: Delivery) -> sa.ColumnElement[bool]:
    return sa.and_(deliveries.c.webhook == delivery.webhook, deliveries.c.event == delivery.event)
