"""Takes over the work of dead workers, and work of this one that its engine has given up."""

import logging
import time
from collections.abc import Callable, Container

from server.engine import Engine, entry_of
from server.store.store import Store
from server.store.tables import Worker

_LOG = logging.getLogger(__name__)


class Heir:
    """Looks at each beat of its worker; `busy` are the entries and parts that the worker has in hand.

    Nobody is declared dead on the evidence of a time in which nobody could beat: a worker inherits only after it has
    itself beaten without a gap for as long as it grants the others.
    """

    def __init__(
        self,
        store: Store,
        engine: Engine,
        me: Worker,
        busy: Container[str],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._store = store
        self._engine = engine
        self._me = me
        self.busy = busy
        self._clock = clock
        self._since: float | None = None  # when the beats without a gap began
        self._last = clock()
        self._idle: dict[str, float] = {}  # entry: since when this worker should work on it and does not

    def look(self) -> None:
        """Queue again what nobody works on any more; to be called after every beat that succeeded."""
        now = self._clock()
        if self._since is None or now - self._last > self._store.workers.dead_s:
            self._since = now
        self._last = now
        running = self._engine.running()
        self._adopt_own([entry_id for entry_id, worker in running.items() if worker == self._me.id], now)
        if now - self._since >= self._store.workers.dead_s:
            self._adopt_of_dead(running)

    def pause(self, reason: str) -> None:
        """Note that a beat failed: the database does not answer."""
        if self._since is not None:
            _LOG.warning("the worker waits for its database: %s", reason)
        self._since = None
        self._idle.clear()

    def _adopt_of_dead(self, running: dict[str, str]) -> None:
        """Adopt the entries of dead workers; the first of the living does it for all."""
        alive = [worker.id for worker in self._store.workers.alive()]
        if not alive or alive[0] != self._me.id:
            return
        orphans = {entry_id: worker for entry_id, worker in running.items() if worker not in alive}
        for found, queue in self._kept(list(orphans)):
            self._engine.adopt(found, orphans[found], queue)

    def _adopt_own(self, mine: list[str], now: float) -> None:
        """Begin again what the engine gave up because it could not write down how it ended."""
        self._idle = {i: self._idle.get(i, now) for i in mine if i not in self.busy}
        lost = [entry_id for entry_id, since in self._idle.items() if now - since >= self._store.workers.dead_s]
        for found, queue in self._kept(lost):
            self._engine.adopt(found, self._me.id, queue)
            del self._idle[found]

    def _kept(self, found: list[str]) -> list[tuple[str, str]]:
        """Return those of entries and parts whose entry is kept, and the queue of each."""
        entries = self._store.entries.find(list({entry_of(one) for one in found})) if found else []
        queues = {entry.id: entry.queue for entry in entries}
        return [(one, queue) for one in found if (queue := queues.get(entry_of(one)))]
