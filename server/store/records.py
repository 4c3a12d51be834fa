"""Reads and writes the rows of a table: what all tables of the service have in common."""

import secrets
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any, ClassVar, Generic, TypeVar

import sqlalchemy as sa

from server.store.database import lock_writers

Row = TypeVar("Row")
Clause = sa.ColumnElement[bool]
_latest_us = 0
_one_at_a_time = threading.Lock()


def iso(at: float) -> str:
    """Return a time in seconds since 1970 as ISO 8601 in UTC, with milliseconds."""
    return datetime.fromtimestamp(at, UTC).isoformat("T", "milliseconds")


def _next_microsecond(at: float) -> int:
    """Return a time in microseconds since 1970, later than any that this process was given."""
    global _latest_us
    with _one_at_a_time:
        _latest_us = max(round(at * 1e6), _latest_us + 1)
        return _latest_us


class Records(Generic[Row]):
    """The rows of `table`, each an object of the class `row`; `clock` gives seconds since 1970."""

    table: ClassVar[sa.Table]
    row: ClassVar[Callable[..., Any]]

    def __init__(self, engine: sa.Engine, clock: Callable[[], float] = time.time) -> None:
        self._engine = engine
        self._clock = clock

    def now(self) -> str:
        """Return the time as rows carry it."""
        return iso(self._clock())

    def dated_id(self, letter: str) -> str:
        """Return an id that nobody has; ids of a letter sort by time, those of one process in their order."""
        seconds, micros = divmod(_next_microsecond(self._clock()), 10**6)
        at = datetime.fromtimestamp(seconds, UTC)
        return f"{letter}{at:%Y%m%d-%H%M%S}-{micros:05x}{secrets.randbelow(16**3):03x}"

    @contextmanager
    def writing(self) -> Iterator[sa.Connection]:
        """Open a transaction that is the only one to write until it ends."""
        with self._engine.begin() as connection:
            lock_writers(connection)
            yield connection

    def rows(
        self, connection: sa.Connection, *clauses: Clause, order: Any = None, limit: int | None = None
    ) -> list[Row]:
        """Return the rows that fit all `clauses`, inside a transaction."""
        query = sa.select(self.table).where(*clauses).order_by(order).limit(limit)
        return [self.row(**found) for found in connection.execute(query).mappings()]

    def select(self, *clauses: Clause, order: Any = None, limit: int | None = None) -> list[Row]:
        """Return the rows that fit all `clauses`, in the order of the column `order`."""
        with self._engine.connect() as connection:
            return self.rows(connection, *clauses, order=order, limit=limit)

    def insert(self, row: Row) -> None:
        """Keep a new row."""
        with self._engine.begin() as connection:
            connection.execute(self.table.insert(), vars(row))

    def update(self, *clauses: Clause, **columns: Any) -> int:
        """Set columns of the rows that fit all `clauses`; return how many there are."""
        with self._engine.begin() as connection:
            return connection.execute(self.table.update().where(*clauses).values(columns)).rowcount

    def delete(self, *clauses: Clause) -> None:
        """Forget the rows that fit all `clauses`."""
        with self._engine.begin() as connection:
            connection.execute(self.table.delete().where(*clauses))
