"""Captures and jobs, as they were asked for and how far they are."""

import re
from collections.abc import Mapping, Sequence
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
    note: str | None


class Open(NamedTuple):
    """An entry that has not ended, as far as was announced."""

    id: str
    queue: str | None
    told: str


@dataclass(frozen=True)
class Filter:
    """Selects entries; None leaves a column open. `before` is the id that the last page ended with.

    `q` is looked for in names, notes, ids and rigs, and in the id and name of a job's capture. `open` says whether the
    last announced status is no end.
    """

    kind: Kind
    type: str | None = None
    rig: str | None = None
    capture: str | None = None
    name: str | None = None
    before: str | None = None
    q: str | None = None
    open: bool | None = None


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
        return self._listed(*_clauses(wanted), limit=limit)

    def finished(self, entry_type: str, limit: int) -> list[Listed]:
        """Return the newest jobs of a type that were done, at most `limit`."""
        return self._listed(
            entries.c.kind == "job", entries.c.type == entry_type, entries.c.told == "done", limit=limit
        )

    def found(self, entry_ids: Sequence[str]) -> list[Listed]:
        """Return those of the entries that exist, as lists need them, newest first."""
        return self._listed(entries.c.id.in_(entry_ids))

    def unfinished(self) -> list[Entry]:
        """Return the entries whose last announced status is not an end."""
        return self.select(_GOES_ON, order=entries.c.id.desc())

    def open(self, wanted: Filter | None = None) -> list[Open]:
        """Return the same, or those that fit, with the columns that are compared with the engine's."""
        clauses = _clauses(wanted) if wanted else []
        with self._engine.connect() as connection:
            query = sa.select(entries.c.id, entries.c.queue, entries.c.told).where(_GOES_ON, *clauses)
            return [Open(*row) for row in connection.execute(query).all()]

    def _listed(self, *clauses: sa.ColumnElement[bool], limit: int | None = None) -> list[Listed]:
        query = sa.select(*_LISTED).where(*clauses).order_by(entries.c.id.desc()).limit(limit)
        with self._engine.connect() as connection:
            return [Listed(*row) for row in connection.execute(query).all()]

    def change(self, entry_id: str, **columns: Any) -> None:
        """Set columns of an entry."""
        self.update(entries.c.id == entry_id, **columns)

    def label(self, kind: Kind, entry_id: str, labels: Mapping[str, str | None]) -> None:
        """Set the `name` and `note` of an entry, or one of them; raises NotFoundError."""
        self.get(kind, entry_id)
        if labels:
            self.change(entry_id, **labels)

    def remove(self, entry_id: str) -> None:
        """Forget an entry, its events and its artefacts."""
        with self._engine.begin() as connection:
            for table, column in ((events, events.c.entry), (artefacts, artefacts.c.entry), (entries, entries.c.id)):
                connection.execute(table.delete().where(column == entry_id))


def _clauses(wanted: Filter) -> list[sa.ColumnElement[bool]]:
    columns = {name: value for name, value in vars(wanted).items() if name in entries.c and value is not None}
    clauses = [entries.c[name] == value for name, value in columns.items()]
    if wanted.before is not None:
        clauses.append(entries.c.id < wanted.before)
    if wanted.q is not None:
        clauses.append(_with_text(wanted.q))
    if wanted.open is not None:
        clauses.append(_GOES_ON if wanted.open else ~_GOES_ON)
    return clauses


def _with_text(text: str) -> sa.ColumnElement[bool]:
    """Return the clause of entries that a person finds by `text`, taken literally, in capitals or not."""
    of = entries.alias("captures")
    named = sa.select(of.c.id).where(of.c.kind == "capture", of.c.name.icontains(text, autoescape=True))
    columns = (entries.c[name] for name in ("id", "name", "note", "rig", "capture"))
    return sa.or_(*(column.icontains(text, autoescape=True) for column in columns), entries.c.capture.in_(named))


_LISTED = [
    sa.cast(column, sa.Text) if isinstance(column.type, sa.JSON) else column
    for column in (entries.c[name] for name in Listed._fields)
]
