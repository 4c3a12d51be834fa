"""Captures and jobs, as they were asked for and how far they are."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import sqlalchemy as sa

from server.errors import NotFoundError
from server.store.records import Records
from server.store.tables import Entry, Kind, artefacts, entries, events

_ID = re.compile(r"[cj]\d{8}-\d{6}-[0-9a-f]{8}")
_GOES_ON = entries.c.told.in_(("new", "queued", "running"))


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
    told: str


class Open(NamedTuple):
    """An entry that has not ended, as far as was announced."""

    id: str
    queue: str | None
    told: str


@dataclass(frozen=True)
class Filter:
    """Selects entries; None leaves a column open. `before` is the id that the last page ended with."""

    kind: Kind
    type: str | None = None
    rig: str | None = None
    capture: str | None = None
    name: str | None = None
    before: str | None = None


class Entries(Records[Entry]):
    """The table of captures and jobs."""

    table, row = entries, Entry

    def add(self, entry: Entry) -> bool:
        """Keep a new entry; return False where one of its id is there already."""
        return bool(self.add_all([entry]))

    def add_all(self, new: Sequence[Entry]) -> list[Entry]:
        """Keep those of new entries whose ids are not there yet, all or none; return them, in their order."""
        with self.writing() as connection:
            there = {entry.id for entry in self.rows(connection, entries.c.id.in_([entry.id for entry in new]))}
            added = [entry for entry in new if entry.id not in there]
            if added:
                connection.execute(entries.insert(), [vars(entry) for entry in added])
        return added

    def get(self, kind: Kind, entry_id: str) -> Entry:
        """Return one entry; raises NotFoundError."""
        known = _ID.fullmatch(entry_id) and entry_id[0] == kind[0]
        found = self.find([entry_id]) if known else []
        if not found:
            raise NotFoundError(f"found no {kind} {entry_id[:60]}", f"one that GET /v1/{kind}s lists")
        return found[0]

    def find(self, entry_ids: Sequence[str]) -> list[Entry]:
        """Return those of the entries that exist, newest first."""
        return self.select(entries.c.id.in_(entry_ids), order=entries.c.id.desc())

    def page(self, wanted: Filter, limit: int) -> list[Entry]:
        """Return the newest entries that fit, at most `limit`."""
        return self.select(*_clauses(wanted), order=entries.c.id.desc(), limit=limit)

    def listed(self, wanted: Filter, limit: int) -> list[Listed]:
        """Return the same, as lists need them."""
        query = sa.select(*_LISTED).where(*_clauses(wanted)).order_by(entries.c.id.desc()).limit(limit)
        with self._engine.connect() as connection:
            return [Listed(*row) for row in connection.execute(query).all()]

    def unfinished(self) -> list[Entry]:
        """Return the entries whose last announced status is not an end."""
        return self.select(_GOES_ON, order=entries.c.id.desc())

    def open(self) -> list[Open]:
        """Return the same, with the columns that are compared with the engine's."""
        with self._engine.connect() as connection:
            found = connection.execute(sa.select(entries.c.id, entries.c.queue, entries.c.told).where(_GOES_ON))
            return [Open(*row) for row in found.all()]

    def change(self, entry_id: str, **columns: Any) -> None:
        """Set columns of an entry."""
        self.update(entries.c.id == entry_id, **columns)

    def remove(self, entry_id: str) -> None:
        """Forget an entry, its events and its artefacts."""
        with self._engine.begin() as connection:
            for table, column in ((events, events.c.entry), (artefacts, artefacts.c.entry), (entries, entries.c.id)):
                connection.execute(table.delete().where(column == entry_id))


def _clauses(wanted: Filter) -> list[sa.ColumnElement[bool]]:
    columns = {name: value for name, value in vars(wanted).items() if name != "before" and value is not None}
    clauses = [entries.c[name] == value for name, value in columns.items()]
    return clauses if wanted.before is None else [*clauses, entries.c.id < wanted.before]


_LISTED = [
    sa.cast(column, sa.Text) if isinstance(column.type, sa.JSON) else column
    for column in (entries.c[name] for name in Listed._fields)
]
