"""Deletes what is old: reports of progress, keys, deliveries, the engine's own memory and, if asked for, old jobs."""

import logging
from collections.abc import Callable

from server.engine import Engine
from server.errors import ServiceError
from server.services.jobs import JobService
from server.services.uploads import UploadService
from server.store.records import iso
from server.store.store import Store

_DAY_S = 24 * 3600.0
_PROGRESS_S = 7 * _DAY_S
_PAGE = 500


class Retention:
    """Deletes what is old; the announcer calls it once an hour."""

    def __init__(
        self,
        store: Store,
        engine: Engine,
        jobs: JobService,
        uploads: UploadService,
        keep_days: float | None,
        keep_upload_days: float,
    ) -> None:
        self._store = store
        self._engine = engine
        self._jobs = jobs
        self._uploads = uploads
        self._keep_days = keep_days
        self._keep_upload_days = keep_upload_days

    def tidy(self) -> None:
        """Delete everything that is due."""
        self._store.events.prune_progress(self._store.clock() - _PROGRESS_S)
        self._store.idempotency.prune()
        self._store.deliveries.prune()
        if self._keep_days is not None:
            self._delete_jobs(self._store.clock() - self._keep_days * _DAY_S)
        self._delete_uploads(self._store.clock() - self._keep_upload_days * _DAY_S)
        self._forget_deleted()
        self._store.folder.sweep()

    def _delete_uploads(self, before: float) -> None:
        for upload in self._store.uploads.before(iso(before)):
            _delete(self._uploads.delete, upload.id)

    def _delete_jobs(self, before: float) -> None:
        for job_id in self._store.events.ended_before(before):
            _delete(self._jobs.delete, job_id)

    def _forget_deleted(self) -> None:
        known = self._engine.ended()
        for start in range(0, len(known), _PAGE):
            page = known[start : start + _PAGE]
            kept = {entry.id for entry in self._store.entries.find(page)}
            for entry_id in page:
                if entry_id not in kept:
                    self._engine.forget(entry_id)


def _delete(delete: Callable[[str], None], found: str) -> None:
    """Delete one thing; what is in use, or what the disk refuses to give up, stays until its time comes."""
    try:
        delete(found)
    except ServiceError:
        return
    except OSError as error:  # the others are deleted all the same
        logging.getLogger(__name__).warning("%s is not deleted: %s", found, error)
