"""Writes a stage's progress into the service's tables, at most twice a second, and never lets it stop the stage."""

import errno
import json
import os
import time
from collections.abc import Callable
from pathlib import Path

from sqlalchemy.exc import SQLAlchemyError

from server.schemas.progress import Preview, Progress
from server.store.database import is_full, is_outage
from server.store.store import Store
from server.work.wording import in_request_words

WRITE_EVERY_S = 0.5
OUTAGE_S = 5.0  # after which a report is tried again: it says more than the one that was lost


class Reporter:
    """The progress of one stage of one entry, of which the share `begins` was done before."""

    def __init__(self, store: Store, entry_id: str, stage: str, begins: float = 0.0) -> None:
        self._store = store
        self._entry_id = entry_id
        self._stage = stage
        self._begins = begins
        self._latest = Progress(stage=stage, fraction=begins)
        (entry,) = store.entries.find([entry_id])
        self._earlier: dict[str, float] = entry.progress.get("seconds", {})
        self._warnings: list[str] = entry.progress.get("warnings", [])
        self._began = time.monotonic()
        self._write()

    def __call__(self, fraction: float, message: str) -> None:
        """Note the progress of the stage."""
        done = self._begins + (1 - self._begins) * fraction
        self._latest = Progress(stage=self._stage, fraction=done, message=self._said(message))
        if time.monotonic() < self._next:
            return
        if not written(self._write):
            self._next = time.monotonic() + OUTAGE_S

    def warn(self, text: str) -> None:
        """Note a warning, once however often it comes; the next report carries it."""
        said = self._said(text)
        if said not in self._warnings:
            self._warnings = [*self._warnings, said]

    def close(self, error: Exception | None = None) -> None:
        """Note that the stage is over, done or with an error."""
        end: dict[str, object] = {"fraction": 1.0}
        if error is not None:
            end = {"error": self._said(str(error)), "bad_input": getattr(error, "bad_input", False)}
        self._latest = self._latest.model_copy(update=end)
        self._write()

    def _said(self, text: str) -> str:
        return in_request_words(self._store.folder.hidden(text))

    def _write(self) -> None:
        now = time.monotonic()
        self._next = now + WRITE_EVERY_S
        seconds = self._earlier.get(self._stage, 0.0) + now - self._began  # earlier attempts count
        by_stage = self._earlier | {self._stage: round(seconds, 2)}
        kept = {"seconds": by_stage, "warnings": self._warnings, "preview": self._preview()}
        self._store.events.progress(self._entry_id, self._latest.model_copy(update=kept).model_dump())

    def _preview(self) -> Preview | None:
        return preview_in(self._store.folder.run(self._entry_id))


def preview_in(run: Path) -> Preview | None:
    """Return what there is to say of the picture that a training draws of itself; None before there is one."""
    told = run / "preview.json"
    try:
        return Preview(**json.loads(told.read_text()), at=told.stat().st_mtime)
    except FileNotFoundError:
        return None


def written(write: Callable[[], None]) -> bool:
    """Call `write`; return False where the database does not answer. Raises OSError where its disk is full."""
    try:
        write()
    except SQLAlchemyError as error:
        if is_full(error):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from error
        if not is_outage(error):
            raise
        return False
    return True
