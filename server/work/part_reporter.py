"""Writes the progress of one part of a training into what its job tells, beside other parts that do the same."""

import time
from typing import Any

from reconstruction.run.parts import PartFolder, shares_of
from server.schemas.progress import Progress
from server.store.store import Store
from server.work.reporter import OUTAGE_S, WRITE_EVERY_S, preview_in, written
from server.work.wording import in_request_words

STAGE = "train"
PARTS_SHARE = 0.95  # of the stage; the rest is joining them
_RUNNING = "running"  # what is kept beside the progress: the share of each part at work, by name


class PartReporter:
    """The progress of the part `name` of a job, by what is there of all parts of its run."""

    def __init__(self, store: Store, entry_id: str, name: str) -> None:
        self._store = store
        self._entry_id = entry_id
        self._name = name
        self._run = store.folder.run(entry_id)
        self._folder = PartFolder(self._run)
        self._shares = {name: last - first for name, (first, last) in shares_of(self._folder.noted()).items()}
        self._fraction: float | None = 0.0
        self._message = ""
        self._warnings: list[str] = []
        self._since = time.monotonic()  # up to which the seconds of the part are noted
        self._next = self._since + WRITE_EVERY_S

    def __call__(self, fraction: float, message: str) -> None:
        """Note the progress of the part."""
        self._fraction, self._message = fraction, self.said(message)
        now = time.monotonic()
        if now >= self._next:
            self._next = now + (WRITE_EVERY_S if written(self._write) else OUTAGE_S)

    def warn(self, text: str) -> None:
        """Note a warning; the next report carries it."""
        self._warnings.append(self.said(text))

    def close(self) -> None:
        """Note that the part is not at work any more."""
        self._fraction = None
        written(self._write)

    def said(self, text: str) -> str:
        """Return a message as it is told: in words of a request, and without the place of the data folder."""
        return in_request_words(self._store.folder.hidden(text))

    def _write(self) -> None:
        self._store.events.change_progress(self._entry_id, self._changed)

    def _changed(self, progress: dict[str, Any]) -> dict[str, Any]:
        """Return the progress of the job with what this part adds to it."""
        now = time.monotonic()
        running = {name: share for name, share in progress.get(_RUNNING, {}).items() if name != self._name}
        if self._fraction is not None:
            running[self._name] = self._fraction
        over = self._folder.there() | self._folder.given_up()
        shares = running | dict.fromkeys(over, 1.0)
        done = sum(share * shares.get(name, 0.0) for name, share in self._shares.items())
        seconds = dict(progress.get("seconds", {}))
        seconds[STAGE] = round(seconds.get(STAGE, 0.0) + now - self._since, 2)
        self._since = now
        latest = Progress(
            stage=STAGE,
            fraction=PARTS_SHARE * min(1.0, done),
            message=f"{len(over)} of {len(self._shares)} parts; {self._message}",
            seconds=seconds,
            warnings=list(dict.fromkeys([*progress.get("warnings", []), *self._warnings])),
            preview=preview_in(self._run),
        )
        return latest.model_dump() | {_RUNNING: running}
