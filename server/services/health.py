"""Whether work would be done."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable

from server.engine import Engine
from server.schemas.system import Check, WorkerInfo, Workers
from server.store.store import Store

_FREE_BYTES = 2**30


class HealthService:
    """The conditions of being ready."""

    def __init__(self, store: Store, engine: Engine, clock: Callable[[], float] = time.time) -> None:
        self._store = store
        self._engine = engine
        self._clock = clock

    def workers(self) -> Workers:
        """The workers that are alive."""
        now = self._clock()
        return Workers(
            items=[
                WorkerInfo(id=one.id, host=one.host, queues=one.queues, age_s=max(0.0, now - one.beat))
                for one in self._store.workers.alive()
            ]
        )

    def checks(self) -> dict[str, Check]:
        """Database, disk, worker."""
        self._engine.check()
        free = shutil.disk_usage(self._store.folder.path).free
        alive = self.workers().items
        worker = (
            Check(ok=True, found=", ".join(f"{one.id} on {one.host}" for one in alive))
            if alive
            else Check(ok=False, found="no worker; run spike4dgs worker on this data folder")
        )
        return {
            "database": Check(ok=True, found="answers"),
            "disk": Check(ok=free >= _FREE_BYTES, found=f"{free / 2**30:.1f} GiB free"),
            "worker": worker,
        }
