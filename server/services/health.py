"""Checks whether the service would do work that it is given."""

import shutil
import time

from server.engine import Engine
from server.schemas.system import Check, WorkerInfo, Workers
from server.store.store import Store

_FREE_BYTES = 2**30


class HealthService:
    """The conditions of being ready."""

    def __init__(self, store: Store, engine: Engine) -> None:
        self._store = store
        self._engine = engine

    def workers(self) -> Workers:
        """Return the workers that are alive."""
        now = time.time()
        alive = self._store.workers.alive()
        return Workers(
            items=[WorkerInfo.model_validate(vars(one) | {"age_s": max(0.0, now - one.beat)}) for one in alive]
        )

    def checks(self) -> dict[str, Check]:
        """Check database, disk and worker."""
        self._engine.check()
        free = shutil.disk_usage(self._store.folder.path).free
        alive = ", ".join(f"{one.id} on {one.host}" for one in self.workers().items)
        return {
            "database": Check(ok=True, found="answers"),
            "disk": Check(ok=free >= _FREE_BYTES, found=f"{free / 2**30:.1f} GiB free"),
            "worker": Check(ok=bool(alive), found=alive or "no worker; run spike4dgs worker on this data folder"),
        }
