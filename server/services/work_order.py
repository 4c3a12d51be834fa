"""Pages of entries in the order of the work: what runs, then the queue as workers take it, then what has ended."""

import re
from dataclasses import replace
from typing import NamedTuple, Self

from server.engine import Engine
from server.errors import UnknownReferenceError
from server.schemas.progress import Status
from server.services.listing import Show, newest, page
from server.store.engine_tables import Place
from server.store.entries import Filter
from server.store.store import Store

_RUNS, _QUEUED, _WAITS, _ENDED = range(4)  # what waits is yet to be queued: its capture is being made
_CURSOR = re.compile(r"w(\d)\.(\d{1,9})\.(\d{1,16})\.([cj]\d{8}-\d{6}-[0-9a-f]{8})")


class _At(NamedTuple):
    """The place of an entry in the whole list; as text a cursor, which is good also when the entry has moved on."""

    part: int
    priority: int
    since_ms: int
    id: str

    def __str__(self) -> str:
        return f"w{self.part}.{self.priority}.{self.since_ms}.{self.id}"

    @classmethod
    def read(cls, cursor: str) -> Self:
        """Return what a cursor says; raises UnknownReferenceError for one of another order."""
        found = _CURSOR.fullmatch(cursor)
        if found is None:
            raise UnknownReferenceError("found the cursor of another order", "`next` of the page before")
        part, priority, since_ms, entry_id = found.groups()
        return cls(int(part), int(priority), int(since_ms), entry_id)

    @classmethod
    def of(cls, entry_id: str, place: Place | None) -> Self:
        """Return the place of an entry that has not ended."""
        if place is None:
            return cls(_WAITS, 0, 0, entry_id)
        return cls(_RUNS if place.runs else _QUEUED, place.priority, place.since_ms, entry_id)


def page_in_work_order(
    store: Store, engine: Engine, wanted: Filter, status: Status | None, limit: int, show: Show
) -> bytes:
    """Return at most `limit` entries as `show` makes them, and the cursor of the next page: `before` of `wanted`.

    Raises UnknownReferenceError for a cursor of another order.
    """
    after = _At.read(wanted.before) if wanted.before else None
    rest = replace(wanted, before=None, open=True)
    found = [] if after and after.part == _ENDED else _open(store, engine, rest, status, limit + 1, after)
    if len(found) <= limit:
        before = after.id if after and after.part == _ENDED else None
        ended = replace(rest, before=before, open=False)
        known = newest(store, engine, ended, status, limit + 1)
        shown = {at.id for at, _ in found}  # one of them may have ended meanwhile
        found += [(_At(_ENDED, 0, 0, entry.id), (entry, word)) for entry, word in known if entry.id not in shown]
    cursor = str(found[limit - 1][0]) if len(found) > limit else None
    return page(show([one for _, one in found[:limit]]), cursor)


def _open(
    store: Store, engine: Engine, wanted: Filter, status: Status | None, most: int, after: _At | None
) -> list[tuple[_At, tuple]]:
    places = {place.id: place for place in engine.places()}
    order = sorted(_At.of(one.id, places.get(one.id)) for one in store.entries.open(wanted))
    left = [at for at in order if after is None or at > after]
    found: list[tuple[_At, tuple]] = []
    while left and len(found) < most:
        part, left = left[:most], left[most:]
        entries = {entry.id: entry for entry in store.entries.found([at.id for at in part])}
        known = engine.statuses(list(entries.values()))
        shown = [at for at in part if at.id in entries and status in (None, known[at.id])]
        found += [(at, (entries[at.id], known[at.id])) for at in shown]
    return found[:most]
