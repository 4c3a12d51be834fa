"""Pages of entries as JSON: filtered by what is kept, then by the status that the engine knows.

Requests and progress are kept as text, which was checked before. Each distinct text is parsed once, not once for every
entry and page: a page of a thousand jobs would take a fifth of a second otherwise.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

from pydantic_core import to_json

from server.engine import Engine
from server.schemas.job_types import JOB_TYPES, RIG_JOB_TYPES
from server.schemas.progress import WITH_ERROR, Progress, Status
from server.store.entries import Filter, Listed
from server.store.store import Store

_TEXTS = 4096
_LOOK_AT = 500  # entries at a time while those of a status are looked for
_REQUESTS = JOB_TYPES | RIG_JOB_TYPES
Document = dict[str, Any]
Found = list[tuple[Listed, Status]]
Show = Callable[[Found], list[Document]]


def page_of(store: Store, engine: Engine, wanted: Filter, status: Status | None, limit: int, show: Show) -> bytes:
    """Return at most `limit` entries, newest first, as `show` makes them, and the cursor of the next page."""
    found = newest(store, engine, wanted, status, limit + 1)
    return page(show(found[:limit]), found[limit - 1][0].id if len(found) > limit else None)


def page(items: Sequence[Document], cursor: str | None) -> bytes:
    """Return a page of a list as JSON."""
    return to_json({"items": items, "next": cursor}, inf_nan_mode="null")


def newest(store: Store, engine: Engine, wanted: Filter, status: Status | None, least: int) -> Found:
    """Return the newest entries of a status, or of any: at least as many as asked for, where there are so many."""
    found: Found = []
    most = least if status is None else max(least, _LOOK_AT)
    while len(found) < least:
        part = store.entries.listed(wanted, most)
        known = engine.statuses(part)
        found.extend((entry, known[entry.id]) for entry in part if status in (None, known[entry.id]))
        if len(part) < most:
            break
        wanted = replace(wanted, before=part[-1].id)
    return found


def job_document(entry: Listed, status: Status) -> Document:
    """Return an entry as a `Job` in JSON, without its outlook."""
    request = _request(entry.type, entry.request)
    shown = _shown(entry, status)
    more = {"priority": entry.priority, "request": request}
    return shown | more | {"resumable": is_resumable(status, bad_input=shown["bad_input"])}


def capture_document(entry: Listed, status: Status) -> Document:
    """Return an entry as a `Capture` in JSON."""
    return _shown(entry, status) | _length(entry.request)


def without_old_error(status: Status) -> Document:
    """Return the fields of progress that an entry of this status does not have: they are of an earlier attempt."""
    return {} if status in WITH_ERROR else {"error": None, "bad_input": False}


def is_resumable(status: Status, *, bad_input: bool) -> bool:
    """Return whether it may help to resume a job."""
    return status == "cancelled" or (status == "failed" and not bad_input)


def _shown(entry: Listed, status: Status) -> Document:
    kept = {name: getattr(entry, name) for name in ("id", "type", "created", "rig", "name", "note")}
    return _progress(entry.progress) | without_old_error(status) | kept | {"status": status}


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
