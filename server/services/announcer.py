"""Tells of every change of status, once and durably, whoever caused it."""

import time
from datetime import datetime

from server.engine import Engine
from server.schemas.progress import ACTIVE, WITH_ERROR, Status
from server.services.queue import Queue
from server.services.repeated import Repeated
from server.services.retention import Retention
from server.store.store import Store
from server.store.tables import Entry

_LOOK_S = 0.5
_LOST_S = 5.0
_TIDY_S = 3600.0


class Announcer:
    """Compares twice a second what was announced of entries with what the engine knows, in a thread of its own."""

    def __init__(self, store: Store, engine: Engine, queue: Queue, retention: Retention) -> None:
        self._store = store
        self._engine = engine
        self._queue = queue
        self._retention = retention
        self._tidied = float("-inf")
        self.thread = Repeated("announcer", self._work, _LOOK_S)

    def look(self) -> None:
        """Tell what has changed since the last look, and queue what was never queued."""
        open_entries = self._store.entries.open()
        known = self._engine.known(open_entries)
        lost = []
        for entry in open_entries:
            now = known[entry.id]
            if entry.told == "new" or now is None:
                lost.append(entry.id)
            if entry.told == "new":
                continue
            now = now or "queued"
            if now != entry.told:
                for latest in self._store.entries.find([entry.id]):
                    self._tell(latest, entry.told, now)
            if now not in ACTIVE:
                self._store.events.thin(entry.id)
        self._queue.requeue(lost, self._is_old)

    def _tell(self, entry: Entry, before: str, now: Status) -> None:
        """Announce, and look again after an end: the entry may have been queued again while it was announced."""
        error = entry.progress.get("error")
        told = self._store.events.tell
        while told(entry.id, before, now, {"error": error if now in WITH_ERROR else None}) is not None:
            latest = self._engine.status(entry)
            if now in ACTIVE or latest == now:
                return
            before, now = now, latest

    def _work(self) -> bool:
        self.look()
        if time.monotonic() - self._tidied >= _TIDY_S:
            self._tidied = time.monotonic()
            self._retention.tidy()
        return False

    def _is_old(self, entry: Entry) -> bool:
        return self._store.clock() - datetime.fromisoformat(entry.created).timestamp() > _LOST_S
