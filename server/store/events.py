"""The events of captures and jobs: numbered, so that a reader can go on where it stopped."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import sqlalchemy as sa

from server.schemas.progress import ENDED
from server.store.records import Records
from server.store.tables import Event, entries, events
from server.store.webhooks import owe


class Events(Records[Event]):
    """The table of events, and the two columns of an entry that change with them."""

    table, row = events, Event

    def progress(self, entry_id: str, progress: dict[str, Any]) -> None:
        """Note the progress of an entry."""
        with self.writing() as connection:
            connection.execute(entries.update().where(entries.c.id == entry_id).values(progress=progress))
            _add(connection, Event(0, entry_id, self._clock(), "progress", progress))

    def change_progress(self, entry_id: str, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
        """Note the progress of an entry on which several processes work: `change` is given the last one."""
        with self.writing() as connection:
            query = sa.select(entries.c.progress).where(entries.c.id == entry_id)
            for (found,) in connection.execute(query).all():
                progress = change(found)
                connection.execute(entries.update().where(entries.c.id == entry_id).values(progress=progress))
                _add(connection, Event(0, entry_id, self._clock(), "progress", progress))

    def tell(self, entry_id: str, before: str, status: str, data: dict[str, Any]) -> int | None:
        """Announce a new status, once; return its number, None where another process has announced since `before`."""
        with self.writing() as connection:
            mine = sa.and_(entries.c.id == entry_id, entries.c.told == before)
            if not connection.execute(entries.update().where(mine).values(told=status)).rowcount:
                return None
            event = _add(connection, Event(0, entry_id, self._clock(), "status", {"status": status} | data))
            owe(connection, event)
            return event.seq

    def after(self, seq: int, entry_id: str | None = None, limit: int = 500) -> list[Event]:
        """Return the next events, oldest first, of one entry or of all."""
        mine = () if entry_id is None else (events.c.entry == entry_id,)
        return self.select(events.c.seq > seq, *mine, order=events.c.seq, limit=limit)

    def last_reports(self, entry_ids: Sequence[str]) -> dict[str, float]:
        """Return the time of the last progress report of each entry that has any."""
        mine = sa.and_(events.c.kind == "progress", events.c.entry.in_(entry_ids))
        query = sa.select(events.c.entry, sa.func.max(events.c.at)).where(mine).group_by(events.c.entry)
        with self._engine.connect() as connection:
            return {row[0]: row[1] for row in connection.execute(query)} if entry_ids else {}

    def last(self) -> int:
        """Return the number of the newest event, 0 before the first."""
        with self._engine.connect() as connection:
            return connection.scalar(sa.select(sa.func.max(events.c.seq))) or 0

    def thin(self, entry_id: str) -> None:
        """Forget all but every tenth progress report of an entry that has ended."""
        self.delete(events.c.entry == entry_id, events.c.kind == "progress", events.c.seq % 10 != 0)

    def ended(self, seq: int, limit: int) -> list[Event]:
        """Return the next endings, oldest first."""
        ending = events.c.data["status"].as_string().in_(ENDED)
        return self.select(events.c.seq > seq, events.c.kind == "status", ending, order=events.c.seq, limit=limit)

    def ended_before(self, at: float) -> list[str]:
        """Return the jobs that have ended and to which nothing has happened since the time `at`."""
        mine = sa.and_(entries.c.kind == "job", entries.c.told.in_(ENDED))
        query = sa.select(entries.c.id).join(events, events.c.entry == entries.c.id).where(mine)
        with self._engine.connect() as connection:
            return list(connection.scalars(query.group_by(entries.c.id).having(sa.func.max(events.c.at) < at)))

    def prune_progress(self, before: float) -> None:
        """Forget progress reports, older than the time `before`, of entries that have ended."""
        over = sa.select(entries.c.id).where(entries.c.told.in_(ENDED))
        self.delete(events.c.kind == "progress", events.c.at < before, events.c.entry.in_(over))


def _add(connection: sa.Connection, event: Event) -> Event:
    row = {name: value for name, value in vars(event).items() if name != "seq"}
    return replace(event, seq=connection.execute(events.insert().values(row).returning(events.c.seq)).scalar_one())
