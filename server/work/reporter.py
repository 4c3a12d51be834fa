"""Writes a stage's progress into the service's tables, at most twice a second."""

from __future__ import annotations

import time

from server.schemas.progress import Progress
from server.store.store import Store

_WRITE_EVERY_S = 0.5


class Reporter:
    """The progress of one stage of one entry."""

    def __init__(self, store: Store, entry_id: str, stage: str) -> None:
        self._store = store
        self._entry_id = entry_id
        self._stage = stage
        self._latest = Progress(stage=stage)
        (entry,) = store.entries.find([entry_id])
        self._earlier: dict[str, float] = entry.progress.get("seconds", {})
        self._began = time.monotonic()
        self._write()

    def __call__(self, fraction: float, message: str) -> None:
        """Progress of the stage."""
        self._latest = Progress(stage=self._stage, fraction=fraction, message=message)
        if time.monotonic() - self._written >= _WRITE_EVERY_S:
            self._write()

    def close(self, error: str | None = None) -> None:
        """The stage is over, done or with an error."""
        end: dict[str, object] = {"fraction": 1.0} if error is None else {"error": error}
        self._latest = self._latest.model_copy(update=end)
        self._write()

    def _write(self) -> None:
        self._written = time.monotonic()
        seconds = self._earlier.get(self._stage, 0.0) + self._written - self._began  # earlier attempts count
        by_stage = self._earlier | {self._stage: round(seconds, 2)}
        self._store.events.progress(self._entry_id, self._latest.model_copy(update={"seconds": by_stage}).model_dump())
