"""Makes and removes entries: each is kept first and queued second, so that none is lost in between."""

import json
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel

from server.engine import Engine
from server.errors import StateError
from server.schemas.progress import ACTIVE
from server.store.store import Store
from server.store.tables import Entry, Kind

Key = str | None


class Queue:
    """Adds entries and queues them; a key that comes again finds the entries of its first use."""

    def __init__(self, store: Store, engine: Engine) -> None:
        self._store = store
        self._engine = engine
        self._moving = threading.Lock()
        self._starter = ThreadPoolExecutor(1, "starter")  # where it fails, `requeue` mends it

    def ids(self, kind: Kind | Literal["upload"], asked: Sequence[BaseModel], key: Key, scope: str) -> list[str]:
        """Return an id for each request; raises IdempotencyError where `key` came with other ones before."""

        def new() -> list[str]:
            return [self._store.entries.dated_id(kind[0]) for _ in asked]

        if key is None:
            return new()
        document = json.dumps([scope, *(request.model_dump(mode="json") for request in asked)], sort_keys=True)
        return self._store.idempotency.claim(key, document, new)

    def once(self, kind: Kind, request: BaseModel, key: Key, scope: str) -> tuple[str, bool]:
        """Return an id for a request, as `ids` does, and whether its entry is there already."""
        (entry_id,) = self.ids(kind, [request], key, scope)
        return entry_id, self.known(entry_id)

    def known(self, entry_id: str) -> bool:
        """Return whether the entry is there already: the request came again."""
        return bool(self._store.entries.find([entry_id]))

    def entry(self, kind: Kind, entry_id: str, asked: BaseModel, **columns: Any) -> Entry:
        """Return the entry of a request, whose name and priority become columns."""
        request = asked.model_dump()
        named = {name: request.pop(name) for name in ("name", "priority") if name in request}
        created = self._store.entries.now()
        return Entry(**{"id": entry_id, "kind": kind, "created": created, "request": request, **named, **columns})

    def add(self, entry: Entry) -> None:
        """Keep an entry and queue it. A crash in between is mended by `requeue`."""
        if self._store.entries.add(entry):
            self.start(entry)

    def add_all(self, entries: Sequence[Entry]) -> None:
        """Keep entries in one transaction, and queue them in their order: many of them beside the request."""
        added = self._store.entries.add_all(entries)
        if len(added) > 1:
            self._starter.submit(self._start_new, [entry.id for entry in added])
        else:
            for entry in added:
                self.start(entry)

    def close(self) -> None:
        """Queue what is still to be queued."""
        self._starter.shutdown()

    def expect_unused(self, name: str) -> None:
        """Raise StateError while an entry at work uses the capture, job or upload `name`."""
        for entry in self._at_work():
            named = [entry.request.get(key) for key in ("job", "dark", "cameras")]
            if name in (*named, *entry.request.get("dats", ()), entry.kind == "job" and entry.capture):
                raise StateError(f"found {name} in use by {entry.id}", "nothing at work on it", "cancel that or wait")

    def start(self, entry: Entry) -> None:
        """Queue a new entry."""
        if entry.queue is not None:
            self._engine.enqueue(entry)
        if entry.told == "new":
            self._store.events.tell(entry.id, "new", "queued" if entry.queue else "done", {})

    def requeue(self, entry_ids: Sequence[str], is_old: Callable[[Entry], bool]) -> None:
        """Queue the entries that are kept but not queued: a capture was not made yet, or a process died in between.

        `entry_ids` seemed to be so a moment ago.
        """
        old = [entry for entry in self._store.entries.find(entry_ids) if is_old(entry)] if entry_ids else []
        known = self._engine.known(old)
        for entry in reversed(old):
            cancelled = entry.told == "new" and known[entry.id] == "cancelled"
            if (entry.told == "new" or (entry.told in ACTIVE and known[entry.id] is None)) and not self.waits(entry):
                self._start_again(entry, cancelled=cancelled)

    def prioritise(self, entry: Entry, priority: int) -> None:
        """Queue a queued entry anew: the engine has no other way. `requeue` mends what a crash leaves half done.

        Raises NotFoundError where it is deleted meanwhile.
        """
        with self._moving:
            latest = self._store.entries.get(entry.kind, entry.id)  # it may have been deleted meanwhile
            self._store.entries.change(entry.id, priority=priority, told="new")
            if latest.told == "new":  # it is still to be queued
                return
            self._engine.cancel(entry.id)  # nobody can take it from the queue now
            self._engine.forget(entry.id)
            self.start(self._store.entries.get(entry.kind, entry.id))

    def again(self, entry: Entry, stage: str | None = None) -> None:
        """Queue an ended entry again, from `stage` on or from the one it stopped in; raises StateError."""
        self._tell_queued(entry)  # first, so that the announcer looks at it even if this process dies on the way
        if self._engine.known([entry])[entry.id] is None:  # its memory was lost: finished stages are found finished
            self._engine.enqueue(entry)
        else:
            self._engine.rewind(entry, stage)
        self._tell_queued(entry)  # again, where the announcer has looked too early

    def remove(self, entry: Entry, *made: Path) -> None:
        """Forget an entry, and delete its log and the folders `made` for it."""
        with self._store.folder.removing(*made, self._store.folder.entry(entry.id)):
            self._store.entries.remove(entry.id)  # before the engine: what is kept and not queued is queued again
        self._engine.forget(entry.id)

    def waits(self, entry: Entry) -> bool:
        """Return whether a job's capture is still being made, or has not begun where the job follows it.

        A job whose capture failed is queued and says so.
        """
        if entry.kind != "job" or entry.capture is None:
            return False
        made = self._engine.statuses(self._store.entries.find([entry.capture]))
        early = ("queued",) if entry.request.get("follow") else ACTIVE
        return any(status in early for status in made.values())

    def _tell_queued(self, entry: Entry) -> None:
        told = self._store.entries.get(entry.kind, entry.id).told
        if told not in ACTIVE:
            self._store.events.tell(entry.id, told, "queued", {})

    def _start_new(self, entry_ids: Sequence[str]) -> None:
        for entry_id in entry_ids:
            with self._moving:
                for latest in self._store.entries.find([entry_id]):
                    if latest.told == "new":
                        self.start(latest)

    def _at_work(self) -> list[Entry]:
        """Return the entries queued or running as the engine knows it: announcements lag by half a second."""
        told = self._store.entries.unfinished()
        now = self._engine.statuses(told)
        return [entry for entry in told if now[entry.id] in ACTIVE]

    def _start_again(self, entry: Entry, *, cancelled: bool) -> None:
        with self._moving:
            (latest,) = self._store.entries.find([entry.id]) or [None]
            if latest is None or latest.told != entry.told:
                return
            if cancelled:  # on its way to another priority
                self._engine.forget(entry.id)
            self.start(latest)
