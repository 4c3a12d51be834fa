"""Which workers are alive: each beats; one that stopped beating is dead, and its jobs go to the others."""

import os
import secrets
import socket
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import sqlalchemy as sa

from server.errors import WorkerRunningError
from server.store.records import Records
from server.store.tables import Worker, workers

DEAD_S = 15.0
_FORGOTTEN_S = 24 * 3600


class Workers(Records[Worker]):
    """The table of workers."""

    table, row = workers, Worker

    def __init__(self, engine: sa.Engine, clock: Callable[[], float] = time.time, dead_s: float = DEAD_S) -> None:
        super().__init__(engine, clock)
        self.dead_s = dead_s
        self.beat_s = min(2.0, dead_s / 6)

    def enter(self, worker_id: str, queues: Sequence[str]) -> Worker:
        """Take the id for this process.

        Raises WorkerRunningError where another process has it: one on this host that is alive, or one on another host
        that beat lately.
        """
        now = self._clock()
        mine = Worker(worker_id, secrets.token_hex(8), socket.gethostname()[:80], os.getpid(), list(queues), now, now)
        with self.writing() as connection:
            for other in self.rows(connection, workers.c.id == worker_id):
                if self._alive(other):
                    raise WorkerRunningError(
                        f"found another worker {worker_id} on {other.host} (process {other.pid})",
                        "none",
                        "stop it or choose another --name",
                    )
            old = sa.or_(workers.c.beat < now - _FORGOTTEN_S, workers.c.id == worker_id)
            connection.execute(workers.delete().where(old))
            connection.execute(workers.insert(), vars(mine))
        return mine

    def beat(self, worker: Worker) -> None:
        """Note that a worker is alive; raises WorkerRunningError where it was declared dead and replaced."""
        if not self._mark(worker, self._clock()):
            raise WorkerRunningError(
                f"found the worker {worker.id} declared dead", f"a beat every {self.beat_s:g} s", "start it again"
            )

    def leave(self, worker: Worker) -> None:
        """Note that the worker ends in order: others need not wait to take over what it left."""
        self._mark(worker, 0.0)

    def alive(self) -> list[Worker]:
        """Return the workers that beat lately."""
        return self.select(workers.c.beat > self._clock() - self.dead_s, order=workers.c.id)

    def _mark(self, worker: Worker, beat: float) -> int:
        return self.update(workers.c.id == worker.id, workers.c.token == worker.token, beat=beat)

    def _alive(self, worker: Worker) -> bool:
        if worker.beat <= self._clock() - self.dead_s:
            return False
        if worker.host != socket.gethostname()[:80]:
            return True
        if worker.pid == os.getpid():  # of an earlier run: processes of a restarted container are numbered anew
            return False
        return _runs(worker.pid)


def _runs(pid: int) -> bool:
    """Return whether a process of this host is alive: one that was killed and not yet waited for is not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"
