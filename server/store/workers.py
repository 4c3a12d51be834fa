"""Which workers are alive: each beats; one that stopped beating is dead, and its jobs go to the others."""

from __future__ import annotations

import os
import secrets
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa

from server.errors import WorkerRunningError
from server.store.database import lock_writers
from server.store.tables import workers

DEAD_S = 15.0
_FORGOTTEN_S = 24 * 3600


@dataclass(frozen=True)
class Worker:
    """A worker; `token` belongs to one process, times are in seconds since 1970."""

    id: str
    token: str
    host: str
    pid: int
    queues: list[str]
    started: float
    beat: float


class Workers:
    """The table of workers."""

    def __init__(self, engine: sa.Engine, clock: Callable[[], float] = time.time, dead_s: float = DEAD_S) -> None:
        self._engine = engine
        self._clock = clock
        self.dead_s = dead_s
        self.beat_s = min(2.0, dead_s / 6)

    def enter(self, worker_id: str, queues: Sequence[str]) -> Worker:
        """Take the id for this process.

        Raises WorkerRunningError where another process has it: one on this host that is alive, or one on another host
        that beat lately.
        """
        now = self._clock()
        mine = Worker(worker_id, secrets.token_hex(8), socket.gethostname()[:80], os.getpid(), list(queues), now, now)
        with self._engine.begin() as connection:
            lock_writers(connection)
            row = connection.execute(sa.select(workers).where(workers.c.id == worker_id)).mappings().first()
            if row is not None and self._alive(Worker(**row)):
                raise WorkerRunningError(
                    f"found another worker {worker_id} on {row['host']} (process {row['pid']})",
                    "none",
                    "stop it or choose another --name",
                )
            connection.execute(workers.delete().where(workers.c.beat < now - _FORGOTTEN_S))
            connection.execute(workers.delete().where(workers.c.id == worker_id))
            connection.execute(workers.insert(), vars(mine))
        return mine

    def beat(self, worker: Worker) -> None:
        """Say that a worker is alive; raises WorkerRunningError where it was declared dead and replaced."""
        with self._engine.begin() as connection:
            mine = sa.and_(workers.c.id == worker.id, workers.c.token == worker.token)
            if not connection.execute(workers.update().where(mine).values(beat=self._clock())).rowcount:
                raise WorkerRunningError(
                    f"found the worker {worker.id} declared dead", f"a beat every {self.beat_s:g} s", "start it again"
                )

    def leave(self, worker: Worker) -> None:
        """The worker ends in order: others need not wait to take over what it left."""
        with self._engine.begin() as connection:
            mine = sa.and_(workers.c.id == worker.id, workers.c.token == worker.token)
            connection.execute(workers.update().where(mine).values(beat=0.0))

    def alive(self) -> list[Worker]:
        """Workers that beat lately."""
        return [worker for worker in self._all() if worker.beat > self._clock() - self.dead_s]

    def _all(self) -> list[Worker]:
        with self._engine.connect() as connection:
            return [Worker(**row) for row in connection.execute(sa.select(workers).order_by(workers.c.id)).mappings()]

    def _alive(self, worker: Worker) -> bool:
        if worker.beat <= self._clock() - self.dead_s:
            return False
        if worker.host != socket.gethostname()[:80]:
            return True
        if worker.pid == os.getpid():  # of an earlier run: processes of a restarted container are numbered anew
            return False
        return _runs(worker.pid)


def _runs(pid: int) -> bool:
    """Whether a process of this host is alive: one that was killed and not yet waited for is not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"
