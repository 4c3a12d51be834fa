"""Checks whether the service would do work that it is given."""

import shutil

from server.engine import Engine
from server.schemas.system import Check, WorkerInfo, Workers
from server.settings import ServiceSettings
from server.store.soundness import DatabaseError, expect_present
from server.store.store import Store
from server.work.keeper import Keeper

_FREE_BYTES = 2**30


class HealthService:
    """The conditions of being ready; `keeper` runs the worker of this process, if it has one."""

    def __init__(self, settings: ServiceSettings, store: Store, engine: Engine, keeper: Keeper | None = None) -> None:
        self._settings = settings
        self._store = store
        self._engine = engine
        self._keeper = keeper

    def workers(self) -> Workers:
        """Return the workers that are alive."""
        now = self._store.clock()
        alive = self._store.workers.alive()
        return Workers(
            items=[WorkerInfo.model_validate(vars(one) | {"age_s": max(0.0, now - one.beat)}) for one in alive]
        )

    def checks(self) -> dict[str, Check]:
        """Check database, disk and worker."""
        free = shutil.disk_usage(self._store.folder.path).free
        return {
            "database": self._database(),
            "disk": Check(ok=free >= _FREE_BYTES, found=f"{free / 2**30:.1f} GiB free"),
            "worker": self._worker(),
        }

    def _database(self) -> Check:
        try:
            expect_present(self._settings)
            self._engine.check()
        except DatabaseError as error:
            return Check(ok=False, found=self._store.folder.hidden(str(error)))
        return Check(ok=True, found="answers")

    def _worker(self) -> Check:
        """Check that a worker lives and, where it is this process's own, that it stays so."""
        alive = ", ".join(f"{one.id} on {one.host}" for one in self.workers().items)
        trouble = self._keeper.trouble if self._keeper else None
        found = trouble or alive or "no worker; run spike4dgs worker on this data folder"
        return Check(ok=bool(alive) and trouble is None, found=found)
