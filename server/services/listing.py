"""Pages of entries: filtered by what is kept, then by the status that the engine knows."""

from __future__ import annotations

from dataclasses import replace

from server.engine import Engine
from server.schemas.progress import Status
from server.store.entries import Entry, Filter
from server.store.store import Store


def page_of(
    store: Store, engine: Engine, wanted: Filter, status: Status | None, limit: int
) -> tuple[list[Entry], str | None]:
    """At most `limit` entries, newest first, and the cursor of the next page."""
    found: list[Entry] = []
    while len(found) <= limit:
        part = store.entries.page(wanted, limit + 1)
        known = engine.statuses(part) if status is not None else {}
        found += [entry for entry in part if status is None or known[entry.id] == status]
        if len(part) <= limit:
            break
        wanted = replace(wanted, before=part[-1].id)
    return found[:limit], found[limit - 1].id if len(found) > limit else None
