"""Records captures: each is a moment, begun once, and no recording of a later one replaces it."""

import signal
from datetime import datetime
from pathlib import Path

from acquisition.durable import write_durably
from acquisition.recording.finalise import left_planes
from acquisition.recording.reader import read_manifest
from acquisition.recording.writer import partial_of
from server.schemas.captures import NEVER_BEGUN
from server.store.store import Store
from server.store.tables import Entry
from server.work.commands import record_arguments
from server.work.processes import Processes
from server.work.reporter import Reporter
from server.work.supervisor import Control, KilledError, StageError, StoppedStageError

PATIENCE_S = 60.0  # longest time from the order to record until a worker takes it up
MISSED = "record again: the moment has passed"


class Beginning:
    """The begin of one capture, which its entry's folder notes.

    `control` has the orders that lie there; `here` says that `is_now` began it.
    """

    def __init__(self, store: Store, entry: Entry) -> None:
        folder = store.folder.entry(entry.id)
        self.control = Control(folder / "stop", folder / "save")
        self._store = store
        self._asked = entry.created
        self._begun = store.folder.begun(entry.id)
        self._partial = partial_of(store.folder.recording(entry.id))
        self.here = False

    def is_now(self) -> bool:
        """Return whether the capture begins now, and note it; False where an earlier worker has begun it.

        Raises StoppedStageError where it was stopped before, StageError where it was asked for too long ago.
        """
        if self._begun.exists() or self._partial.exists():  # workers of old left no mark
            return False
        if self.control.stop.exists():
            raise StoppedStageError(NEVER_BEGUN)
        now = self._store.entries.now()
        late_s = (datetime.fromisoformat(now) - datetime.fromisoformat(self._asked)).total_seconds()
        if late_s > PATIENCE_S:
            found = f"found that no worker took it up for {late_s:.0f} s"
            raise StageError(found, f"one within {PATIENCE_S:.0f} s", MISSED)
        write_durably(self._begun, "")
        self.here = True
        return True


class Moments:
    """Makes the captures of one service."""

    def __init__(self, store: Store, processes: Processes) -> None:
        self._store = store
        self._processes = processes

    async def record(self, entry: Entry, stage: str, rig: str, devices: str, lock: Path) -> None:
        """Record a moment: what a worker that died has begun is finished as it is, and never begun anew.

        Raises StoppedStageError where it was stopped before anything was kept, and StageError where it failed.
        """
        recording, beginning = self._store.folder.recording(entry.id), Beginning(self._store, entry)
        try:
            await self._processes.run(
                entry,
                stage,
                record_arguments(entry.request, rig, devices, recording, self._store.disk.keep_free),
                locks=[lock],
                control=beginning.control,
                is_due=beginning.is_now,
                ends_in_order=True,
            )
            if beginning.here:
                return
        except StoppedStageError as stopped:
            self._say(entry, stage, stopped.found)
            raise
        except KilledError as killed:
            if not recording.exists() and not left_planes(recording):
                raise self._nothing_kept(entry, stage, killed, beginning.control) from killed
        except StageError:
            if not recording.exists():  # else it was kept, and says itself what it lacks
                raise
        if not recording.exists():
            await self._finalise(entry, stage, recording, lock)
        self.tell_losses(entry, stage)

    async def run_import(self, entry: Entry, stage: str, arguments: list[str]) -> None:
        """Make a recording of files; raises StageError where it failed."""
        try:
            await self._processes.run(entry, stage, arguments)
        except KilledError:
            if not self._store.folder.recording(entry.id).exists():  # else it was killed after it had its name
                raise
            self.tell_losses(entry, stage)

    def tell_losses(self, entry: Entry, stage: str) -> None:
        """Say of a recording that is kept what it lacks, and take back what was said of its recorder's death."""
        reason = read_manifest(self._store.folder.recording(entry.id)).reason
        self._say(entry, stage, "kept, complete" if reason is None else f"kept, incomplete: {reason}")

    def _say(self, entry: Entry, stage: str, text: str) -> None:
        reporter = Reporter(self._store, entry.id, stage)
        reporter(1.0, text)
        reporter.close()

    async def _finalise(self, entry: Entry, stage: str, recording: Path, lock: Path) -> None:
        """Make a recording of the planes that a killed recorder kept; raises StageError where it kept none."""
        try:
            await self._processes.run(entry, stage, ["finalise", str(recording)], locks=[lock])
        except StageError as error:
            if recording.exists():  # it was killed after it had given the recording its name
                return
            if left_planes(recording):  # it can be tried again
                raise
            raise self._missed(entry, stage) from error

    def _nothing_kept(self, entry: Entry, stage: str, killed: KilledError, control: Control) -> StageError:
        """Return the end of a recorder that was killed before it kept planes: by an order to stop, or by accident."""
        if killed.number != signal.SIGTERM or not control.stop.exists():
            return self._missed(entry, stage)
        self._say(entry, stage, NEVER_BEGUN)  # the order did not wait any longer for its first report
        return StoppedStageError(NEVER_BEGUN)

    def _missed(self, entry: Entry, stage: str) -> StageError:
        missed = StageError("found it cut off before its first planes were kept", "a recording", MISSED)
        Reporter(self._store, entry.id, stage).close(missed)
        return missed
