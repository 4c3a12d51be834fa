"""Pages of entries as JSON: filtered by what is kept, then by the status that the engine knows.

Requests and progress are kept as text, which was checked before. Each distinct text is parsed once, not once for every
entry and page: a page of a thousand jobs would take a fifth of a second otherwise.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

from pydantic_core import to_json

from server.engine import Engine
from server.schemas.job_types import JOB_TYPES, RIG_JOB_TYPES
from server.schemas.progress import Progress, Status
from server.store.entries import Filter, Listed
from server.store.store import Store

_TEXTS = 4096
_LOOK_AT = 500  # entries at a time while those of a status are looked for
_REQUESTS = JOB_TYPES | RIG_JOB_TYPES
Document = dict[str, Any]


def page_of(
    store: Store,
    engine: Engine,
    wanted: Filter,
    status: Status | None,
    limit: int,
    document: Callable[[Listed, Status], Document],
) -> bytes:
    """Return at most `limit` entries, newest first, as `document` shows them, and the cursor of the next page."""
    found: list[Document] = []
    most = limit + 1 if status is None else max(limit + 1, _LOOK_AT)
    while len(found) <= limit:
        part = store.entries.listed(wanted, most)
        known = engine.statuses(part)
        found += [document(entry, known[entry.id]) for entry in part if status in (None, known[entry.id])]
        if len(part) < most:
            break
        wanted = replace(wanted, before=part[-1].id)
    cursor = found[limit - 1]["id"] if len(found) > limit else None
    return to_json({"items": found[:limit], "next": cursor}, inf_nan_mode="null")


def job_document(entry: Listed, status: Status) -> Document:
    """Return an entry as a `Job` in JSON."""
    request = _request(entry.type, entry.request)
    return _shown(entry, status) | {"priority": entry.priority, "request": request}


def capture_document(entry: Listed, status: Status) -> Document:
    """Return an entry as a `Capture` in JSON."""
    return _shown(entry, status) | _length(entry.request)


def _shown(entry: Listed, status: Status) -> Document:
    kept = {name: getattr(entry, name) for name in ("id", "type", "created", "rig", "name")}
    return _progress(entry.progress) | kept | {"status": status}


@lru_cache(_TEXTS)
def _request(job_type: str, text: str) -> Document:
    """Return a request with all its fields, not to be changed."""
    return _REQUESTS[job_type].model_validate_json(text).model_dump(mode="json")


@lru_cache(_TEXTS)
def _progress(text: str) -> Document:
    """Return progress with all its fields, not to be changed."""
    return Progress.model_validate_json(text).model_dump(mode="json")


@lru_cache(_TEXTS)
def _length(text: str) -> Document:
    request = json.loads(text)
    return {name: request.get(name) for name in ("ticks", "pre_trigger_ms")}
