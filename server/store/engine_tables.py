"""Reads from the job engine's tables what is asked most often, without the thirty columns its own client fetches."""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy.dialects.postgresql import ARRAY

from server.settings import ServiceSettings
from server.store.database import open_engine_database

WORKFLOW = "entry"  # a capture or job
PART = "part"  # a part of the training of a job, which waits for all of them
WAITING = "waiting"  # the queue of jobs that wait for their parts: no worker takes anything from it
SPANS = "spans"  # what the parts are counted as


class Place(NamedTuple):
    """An entry that runs or is queued; workers take the lowest `priority` first and, of equal ones, the oldest.

    `since_ms` is when it was queued, in milliseconds since 1970. One that waits for its parts runs, in the queue
    WAITING.
    """

    id: str
    queue: str
    runs: bool
    priority: int
    since_ms: int


class EngineTables:
    """A reader of the job engine's workflow table, which the engine documents; it never writes.

    What is in the queue WAITING belongs to the queue `home`.
    """

    def __init__(self, settings: ServiceSettings, home: str) -> None:
        self._home = home
        names = ("workflow_uuid", "status", "name", "queue_name", "priority", "created_at")
        self._on_sqlite = settings.database is None
        schema = None if self._on_sqlite else "dbos"
        self._columns = c = sa.table("workflow_status", *(sa.column(name) for name in names), schema=schema).c
        self._status = sa.case((c.queue_name == WAITING, "PENDING"), else_=c.status)
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
        """Return how many entries of each queue have each of `statuses`; parts of jobs count as a queue, SPANS."""
        c = self._columns
        queue = sa.case((c.name == PART, SPANS), (c.queue_name == WAITING, self._home), else_=c.queue_name)
        one = sa.select(queue.label("queue"), self._status.label("status")).where(c.status.in_(statuses)).subquery().c
        query = sa.select(one.queue, one.status, sa.func.count()).group_by(one.queue, one.status)
        with self._engine.connect() as connection:
            return {(row[0] or "", row[1]): row[2] for row in connection.execute(query)}

    def places(self, statuses: Sequence[str], running: str) -> list[Place]:
        """Return all entries of `statuses` in the order in which workers take them; `running` is one of these."""
        c = self._columns
        query = sa.select(c.workflow_uuid, c.queue_name, self._status, c.priority, c.created_at).where(
            c.status.in_(statuses), c.name == WORKFLOW
        )
        with self._engine.connect() as connection:
            rows = connection.execute(query.order_by(c.priority, c.created_at, c.workflow_uuid)).all()
        return [Place(row[0], row[1] or "", row[2] == running, row[3] or 0, row[4]) for row in rows]

    def beginning_with(self, prefix: str) -> dict[str, str]:
        """Return the engine's own word for the state of all whose ids begin with `prefix`, by id."""
        c = self._columns
        query = sa.select(c.workflow_uuid, c.status).where(c.workflow_uuid.startswith(prefix, autoescape=True))
        with self._engine.connect() as connection:
            return {row[0]: row[1] for row in connection.execute(query)}

    def waiting(self) -> list[str]:
        """Return the jobs that wait for their parts."""
        c = self._columns
        query = sa.select(c.workflow_uuid).where(c.queue_name == WAITING, c.status == "ENQUEUED")
        with self._engine.connect() as connection:
            return list(connection.scalars(query))

    def parts_at_work(self) -> list[str]:
        """Return the ids of the parts that are queued or running."""
        c = self._columns
        query = sa.select(c.workflow_uuid).where(c.name == PART, c.status.in_(("ENQUEUED", "PENDING")))
        with self._engine.connect() as connection:
            return list(connection.scalars(query))

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
        return sa.select(self._columns.workflow_uuid, self._status).where(within)
