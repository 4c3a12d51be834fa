"""Reads from the job engine's tables what is asked most often, without the thirty columns its own client fetches."""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.dialects.postgresql import ARRAY

from server.settings import ServiceSettings
from server.store.database import open_engine_database


class Place(NamedTuple):
    """An entry that runs or is queued; workers take the lowest `priority` first and, of equal ones, the oldest.

    `since_ms` is when it was queued, in milliseconds since 1970.
    """

    id: str
    queue: str
    runs: bool
    priority: int
    since_ms: int


class EngineTables:
    """A reader of the job engine's workflow table, which the engine documents; it never writes."""

    def __init__(self, settings: ServiceSettings) -> None:
        names = ("workflow_uuid", "status", "queue_name", "priority", "created_at")
        self._on_sqlite = settings.database is None
        schema = None if self._on_sqlite else "dbos"
        self._columns = sa.table("workflow_status", *(sa.column(name) for name in names), schema=schema).c
        self._statuses = self._query()
        self._engine = open_engine_database(settings)

    def statuses(self, ids: Sequence[str]) -> dict[str, str]:
        """Return the engine's own word for the state of each of `ids` that it knows."""
        if not ids:
            return {}
        with self._engine.connect() as connection:
            wanted = {"ids": json.dumps(ids) if self._on_sqlite else list(ids)}
            return {row[0]: row[1] for row in connection.execute(self._statuses, wanted).all()}

    def count(self, statuses: Sequence[str]) -> dict[tuple[str, str], int]:
        """Return how many entries of each queue have each of `statuses`."""
        queue, status = self._columns.queue_name, self._columns.status
        query = sa.select(queue, status, sa.func.count()).where(status.in_(statuses)).group_by(queue, status)
        with self._engine.connect() as connection:
            return {(row[0] or "", row[1]): row[2] for row in connection.execute(query)}

    def places(self, statuses: Sequence[str], running: str) -> list[Place]:
        """Return all entries of `statuses` in the order in which workers take them; `running` is one of these."""
        c = self._columns
        query = sa.select(c.workflow_uuid, c.queue_name, c.status, c.priority, c.created_at).where(
            c.status.in_(statuses)
        )
        with self._engine.connect() as connection:
            rows = connection.execute(query.order_by(c.priority, c.created_at, c.workflow_uuid)).all()
        return [Place(row[0], row[1] or "", row[2] == running, row[3] or 0, row[4]) for row in rows]

    def close(self) -> None:
        """Let go of the database."""
        self._engine.dispose()

    def _query(self) -> sa.Select[Any, Any]:
        """Return the query of `statuses`. All ids are one parameter: preparing thousands costs more than the search."""
        ids = sa.bindparam("ids")
        if self._on_sqlite:
            within = self._columns.workflow_uuid.in_(sa.select(sa.func.json_each(ids).table_valued("value").c.value))
        else:
            within = self._columns.workflow_uuid == sa.any_(sa.cast(ids, ARRAY(sa.Text)))
        return sa.select(self._columns.workflow_uuid, self._columns.status).where(within)
