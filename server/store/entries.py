"""Captures and jobs, as they were asked for and how far they are."""

from __future__ import annotations

import re
import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Literal, NamedTuple

import sqlalchemy as sa

from server.errors import NotFoundError
from server.store.database import lock_writers
from server.store.tables import artefacts, entries, events

Kind = Literal["capture", "job"]
_ID = re.compile(r"[cj]\d{8}-\d{6}-[0-9a-f]{8}")
_GOES_ON = ("new", "queued", "running")


def now() -> datetime:
    """The time in UTC."""
    return datetime.now(UTC)


@dataclass(frozen=True)
class Entry:
    """What was asked for, when; `told` is the last status that was announced, `new` before the first."""

    id: str
    kind: Kind
    type: str
    created: str
    request: dict[str, Any]
    rig: str | None = None
    capture: str | None = None
    name: str | None = None
    queue: str | None = None
    priority: int = 0
    progress: dict[str, Any] = field(default_factory=dict)
    restart: dict[str, Any] | None = None
    told: str = "new"


class Listed(NamedTuple):
    """An entry as lists need it, quick to read by the thousand: `request` and `progress` are JSON, as they are kept."""

    id: str
    type: str
    created: str
    rig: str | None
    name: str | None
    queue: str | None
    priority: int
    request: str
    progress: str


class Open(NamedTuple):
    """An entry that has not ended, as far as was announced."""

    id: str
    queue: str | None
    told: str


@dataclass(frozen=True)
class Filter:
    """Which entries to list; None leaves a column open. `before` is the id that the last page ended with."""

    kind: Kind
    type: str | None = None
    rig: str | None = None
    capture: str | None = None
    name: str | None = None
    before: str | None = None


class Entries:
    """The table of captures and jobs."""

    def __init__(
        self,
        engine: sa.Engine,
        clock: Callable[[], datetime] = now,
        token: Callable[[], str] = lambda: secrets.token_hex(4),
    ) -> None:
        self._engine = engine
        self._clock = clock
        self._token = token

    def new_id(self, kind: Kind) -> str:
        """An id that nobody has; ids sort by time."""
        return f"{kind[0]}{self._clock():%Y%m%d-%H%M%S}-{self._token()}"

    def created(self) -> str:
        """The time, as entries carry it."""
        return self._clock().isoformat("T", "milliseconds")

    def add(self, entry: Entry) -> bool:
        """Keep a new entry; False where one of its id is there already."""
        with self._engine.begin() as connection:
            lock_writers(connection)
            if connection.scalar(sa.select(entries.c.id).where(entries.c.id == entry.id)):
                return False
            connection.execute(entries.insert(), vars(entry))
        return True

    def get(self, kind: Kind, entry_id: str) -> Entry:
        """One entry; raises NotFoundError."""
        known = _ID.fullmatch(entry_id) and entry_id[0] == kind[0]
        found = self.find([entry_id]) if known else []
        if not found:
            raise NotFoundError(f"found no {kind} {entry_id[:60]}", f"one that GET /v1/{kind}s lists")
        return found[0]

    def find(self, entry_ids: Sequence[str]) -> list[Entry]:
        """Those of the entries that exist, newest first."""
        return self._select(entries.c.id.in_(entry_ids))

    def page(self, wanted: Filter, limit: int) -> list[Entry]:
        """The newest entries that fit, at most `limit`."""
        return self._select(*_clauses(wanted), limit=limit)

    def listed(self, wanted: Filter, limit: int) -> list[Listed]:
        """The same, as lists need them."""
        query = sa.select(*_LISTED).where(*_clauses(wanted)).order_by(entries.c.id.desc()).limit(limit)
        with self._engine.connect() as connection:
            return [Listed(*row) for row in connection.execute(query).all()]

    def unfinished(self) -> list[Entry]:
        """Entries whose last announced status is not an end."""
        return self._select(entries.c.told.in_(_GOES_ON))

    def open(self) -> list[Open]:
        """The same, as who compares them with the engine needs them."""
        query = sa.select(entries.c.id, entries.c.queue, entries.c.told).where(entries.c.told.in_(_GOES_ON))
        with self._engine.connect() as connection:
            return [Open(*row) for row in connection.execute(query).all()]

    def change(self, entry_id: str, **columns: Any) -> None:
        """Set columns of an entry."""
        with self._engine.begin() as connection:
            connection.execute(entries.update().where(entries.c.id == entry_id).values(**columns))

    def remove(self, entry_id: str) -> None:
        """Forget an entry, its events and its artefacts."""
        with self._engine.begin() as connection:
            for table, column in ((events, events.c.entry), (artefacts, artefacts.c.entry), (entries, entries.c.id)):
                connection.execute(table.delete().where(column == entry_id))

    def _select(self, *clauses: sa.ColumnElement[bool], limit: int | None = None) -> list[Entry]:
        query = sa.select(entries).where(*clauses).order_by(entries.c.id.desc()).limit(limit)
        with self._engine.connect() as connection:
            return [Entry(**row) for row in connection.execute(query).mappings()]


def _clauses(wanted: Filter) -> list[sa.ColumnElement[bool]]:
    columns = {name: value for name, value in vars(wanted).items() if name != "before" and value is not None}
    clauses = [entries.c[name] == value for name, value in columns.items()]
    return clauses if wanted.before is None else [*clauses, entries.c.id < wanted.before]


_LISTED = [
    sa.cast(column, sa.Text) if isinstance(column.type, sa.JSON) else column
    for column in (entries.c[name] for name in Listed._fields)
]
