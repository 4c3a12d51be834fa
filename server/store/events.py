"""What happened to captures and jobs: numbered, so that a reader can go on where it stopped."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import sqlalchemy as sa

from server.store.database import lock_writers
from server.store.deliveries import owe
from server.store.event import Event
from server.store.tables import entries, events

_ENDS = ("done", "failed", "cancelled")


class Events:
    """The table of events, and the two columns of an entry that change with them."""

    def __init__(self, engine: sa.Engine, clock: Callable[[], float] = time.time) -> None:
        self._engine = engine
        self._clock = clock

    def progress(self, entry_id: str, progress: dict[str, Any]) -> None:
        """Say how far an entry is."""
        with self._engine.begin() as connection:
            lock_writers(connection)
            connection.execute(entries.update().where(entries.c.id == entry_id).values(progress=progress))
            self._add(connection, Event(0, entry_id, self._clock(), "progress", progress))

    def tell(self, entry_id: str, before: str, status: str, data: dict[str, Any]) -> int | None:
        """Announce a new status, once: None where another process has announced something since `before`."""
        with self._engine.begin() as connection:
            lock_writers(connection)
            mine = sa.and_(entries.c.id == entry_id, entries.c.told == before)
            if not connection.execute(entries.update().where(mine).values(told=status)).rowcount:
                return None
            event = Event(0, entry_id, self._clock(), "status", {"status": status} | data)
            event = replace(event, seq=self._add(connection, event))
            owe(connection, event)
            return event.seq

    def after(self, seq: int, entry_id: str | None = None, limit: int = 500) -> list[Event]:
        """The next events, oldest first, of one entry or of all."""
        query = sa.select(events).where(events.c.seq > seq).order_by(events.c.seq).limit(limit)
        if entry_id is not None:
            query = query.where(events.c.entry == entry_id)
        with self._engine.connect() as connection:
            return [Event(**row) for row in connection.execute(query).mappings()]

    def last(self) -> int:
        """The number of the newest event, 0 before the first."""
        with self._engine.connect() as connection:
            return connection.scalar(sa.select(sa.func.max(events.c.seq))) or 0

    def thin(self, entry_id: str) -> None:
        """Forget all but every tenth progress report of an entry that has ended."""
        with self._engine.begin() as connection:
            old = sa.and_(events.c.entry == entry_id, events.c.kind == "progress", events.c.seq % 10 != 0)
            connection.execute(events.delete().where(old))

    def ended(self, seq: int, limit: int) -> list[Event]:
        """The next endings, oldest first."""
        word = events.c.data["status"].as_string()
        ending = sa.and_(events.c.seq > seq, events.c.kind == "status", word.in_(_ENDS))
        with self._engine.connect() as connection:
            query = sa.select(events).where(ending).order_by(events.c.seq).limit(limit)
            return [Event(**row) for row in connection.execute(query).mappings()]

    def ended_before(self, at: float) -> list[str]:
        """Jobs that have ended, nothing having happened to them since a time."""
        mine = sa.and_(entries.c.kind == "job", entries.c.told.in_(_ENDS))
        query = sa.select(entries.c.id).join(events, events.c.entry == entries.c.id).where(mine)
        with self._engine.connect() as connection:
            return list(connection.scalars(query.group_by(entries.c.id).having(sa.func.max(events.c.at) < at)))

    def prune_progress(self, before: float) -> None:
        """Forget progress reports, older than a time, of entries that have ended."""
        over = sa.select(entries.c.id).where(entries.c.told.in_(_ENDS))
        old = sa.and_(events.c.kind == "progress", events.c.at < before, events.c.entry.in_(over))
        with self._engine.begin() as connection:
            connection.execute(events.delete().where(old))

    @staticmethod
    def _add(connection: sa.Connection, event: Event) -> int:
        row = {"entry": event.entry, "at": event.at, "kind": event.kind, "data": event.data}
        return connection.execute(events.insert().values(row).returning(events.c.seq)).scalar_one()
