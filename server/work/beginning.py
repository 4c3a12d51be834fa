"""Decides whether a capture may begin: it is a moment, and no recording of a later one replaces it."""

from datetime import datetime

from acquisition.durable import write_durably
from server.store.store import Store
from server.store.tables import Entry
from server.work.supervisor import Control, StageError

PATIENCE_S = 60.0  # longest time from the order to record until a worker takes it up
MISSED = "record again: the moment has passed"


class Beginning:
    """The begin of one capture, which its entry's folder notes.

    `control` has the orders that lie there; `earlier` says that `is_now` found it begun before.
    """

    def __init__(self, store: Store, entry: Entry) -> None:
        folder = store.folder.entry(entry.id)
        self.control = Control(folder / "stop", folder / "save")
        self._store = store
        self._asked = entry.created
        self._begun = folder / "begun"
        self.earlier = False

    def is_now(self) -> bool:
        """Return whether the capture begins now, and note it; False where an earlier worker has begun it.

        Raises StageError where it was stopped before, or was asked for too long ago.
        """
        self.earlier = self._begun.exists()
        if self.earlier:
            return False
        if self.control.stop.exists():
            raise StageError("found it stopped before it began", "none", "record again")
        now = self._store.entries.now()
        late_s = (datetime.fromisoformat(now) - datetime.fromisoformat(self._asked)).total_seconds()
        if late_s > PATIENCE_S:
            found = f"found that no worker took it up for {late_s:.0f} s"
            raise StageError(found, f"one within {PATIENCE_S:.0f} s", MISSED)
        write_durably(self._begun, "")
        return True
