"""Captures: started, stopped, listed and deleted."""

import threading

from acquisition.recording.finalise import left_planes
from acquisition.recording.writer import partial_of
from rigs.rig import Rig
from server.engine import Engine, capture_queue
from server.errors import NotFoundError, RigBusyError, StateError, UnknownReferenceError
from server.schemas.captures import NEVER_BEGUN, Capture, CaptureRequest, Labels
from server.schemas.progress import ACTIVE, Progress, Status
from server.schemas.rigs import RigInfo, Rigs
from server.services.listing import Document, Found, capture_document, page_of, without_old_error
from server.services.queue import Key, Queue
from server.services.space import Space
from server.settings import RigSource
from server.store.entries import Filter, Listed
from server.store.files import is_locked
from server.store.store import Store
from server.store.tables import Entry


class RigService:
    """The rigs, and the captures they are told to make."""

    def __init__(self, store: Store, engine: Engine, queue: Queue, space: Space, sources: dict[str, RigSource]) -> None:
        self._store = store
        self._engine = engine
        self._queue = queue
        self._space = space
        self._sources = sources
        self.rigs = space.rigs
        self._one_at_a_time = threading.Lock()

    def list(self) -> Rigs:
        """Return all rigs."""
        return Rigs(items=[self.get(rig_id) for rig_id in self.rigs])

    def rig(self, rig_id: str) -> Rig:
        """Return a rig as it is described; raises NotFoundError."""
        if rig_id not in self.rigs:
            raise NotFoundError(f"found no rig {rig_id[:60]}", f"one of {', '.join(self.rigs)}")
        return self.rigs[rig_id]

    def get(self, rig_id: str) -> RigInfo:
        """Return one rig; raises NotFoundError."""
        rig = self.rig(rig_id)
        current, stored = self._store.calibrations.current(rig_id)
        shown = {
            "id": rig_id,
            "poses": stored.poses if stored else rig.poses,
            "calibration": current.version,
            "devices": self._sources[rig_id].devices,
            "busy": self._engine.active(capture_queue(rig_id)),
        }
        return RigInfo.model_validate(vars(rig) | shown, from_attributes=True)

    def start(self, rig_id: str, request: CaptureRequest, key: Key = None) -> str:
        """Queue a recording; return its id.

        Raises NotFoundError, NoRoomError, RigBusyError while it is busy, and UnknownReferenceError for no more ticks
        than come before the trigger.
        """
        before = round((request.pre_trigger_ms or 0.0) * 1e-3 * self.rig(rig_id).tick_rate_hz)
        if request.ticks is not None and request.ticks <= before:
            raise UnknownReferenceError(f"found {request.ticks} ticks with the {before} before the trigger", "more")
        capture_id, known = self._queue.once("capture", request, key, rig_id)
        if not known:
            queue = capture_queue(rig_id)
            entry = self._queue.entry("capture", capture_id, request, type="record", rig=rig_id, queue=queue)
            self.add_where_idle(entry, self._space.recording_bytes(rig_id, entry.request))
        return capture_id

    def add_where_idle(self, entry: Entry, wanted: int = 0) -> None:
        """Queue an entry that uses its rig's cameras and `wanted` bytes of the disk.

        Raises RigBusyError while anything else uses them, and NoRoomError. One that is there already stays as it is.
        """
        with self._one_at_a_time:
            if self._queue.known(entry.id):  # the same request came twice at once
                return
            busy = self._engine.active(entry.queue or "")
            if busy is not None:
                raise RigBusyError(f"found rig {entry.rig} busy with {busy}", "it idle", "wait for that to end")
            with self._space.promised(wanted):
                self._queue.add(entry)


class CaptureService:
    """The captures themselves, however they came."""

    def __init__(self, store: Store, engine: Engine, queue: Queue) -> None:
        self._store = store
        self._engine = engine
        self._queue = queue

    def get(self, capture_id: str) -> Capture:
        """Return one capture; raises NotFoundError."""
        entry = self._store.entries.get("capture", capture_id)
        status = self._engine.status(entry)
        asked = {name: entry.request.get(name) for name in ("ticks", "pre_trigger_ms")}
        known = {"status": status, "partial_planes": self._left(entry, status)} | without_old_error(status)
        return Capture.model_validate(vars(entry) | entry.progress | asked | known)

    def page(self, wanted: Filter, status: Status | None = None, limit: int = 100) -> bytes:
        """Return a page of captures, newest first: `Captures` as JSON."""
        return page_of(self._store, self._engine, wanted, status, limit, self._documents)

    def label(self, capture_id: str, labels: Labels) -> Capture:
        """Give a capture another name or note; raises NotFoundError."""
        self._store.entries.label("capture", capture_id, labels.model_dump(exclude_unset=True))
        return self.get(capture_id)

    def tell(self, rig_id: str, capture_id: str, word: str) -> Capture:
        """Tell a capture of a rig to `stop`, or to `save` its pre-trigger; raises NotFoundError, StateError."""
        capture = self.get(capture_id)
        if capture.rig != rig_id:
            raise NotFoundError(f"found {capture_id} to be of rig {capture.rig}, not {rig_id[:60]}", "its own rig")
        if capture.status not in ACTIVE or capture.type != "record":
            raise StateError(f"found {capture.id} {capture.status}", "it recording")
        if word == "save" and capture.pre_trigger_ms is None:
            raise StateError(f"found {capture.id} without pre-trigger, all of it saved", "one with it", "stop it")
        (self._store.folder.entry(capture_id) / word).touch()  # whoever takes it up finds it there
        if capture.status == "queued" and word == "stop":
            self._withdraw(capture_id)
        return self.get(capture_id)

    def cancel(self, capture_id: str) -> Capture:
        """Give up an import that is queued or running; raises NotFoundError, StateError."""
        capture = self.get(capture_id)
        if capture.status not in ACTIVE or capture.type != "import":
            found = f"found {capture.id}, of type {capture.type}, {capture.status}"
            raise StateError(found, "an import at work", "a recording is stopped")
        self._engine.cancel(capture_id)
        return self.get(capture_id)

    def finalise(self, capture_id: str) -> Capture:
        """Make a recording of the planes that a recorder which failed has left; raises NotFoundError, StateError."""
        entry = self._ended(capture_id)
        if not self._left(entry, self._engine.status(entry)):
            raise StateError(f"found no planes that {capture_id} left unfinished", "some", "record again")
        self._queue.again(entry)
        return self.get(capture_id)

    def log(self, capture_id: str) -> str:
        """Return the log of making a capture, an import's doubts among it; raises NotFoundError."""
        return self._store.folder.logged(self._store.entries.get("capture", capture_id).id)

    def delete(self, capture_id: str) -> None:
        """Delete a capture and what was recorded; raises NotFoundError, and StateError while it is in use."""
        entry = self._ended(capture_id)
        self._queue.expect_unused(capture_id)
        recording = self._store.folder.recording(capture_id)
        self._queue.remove(entry, recording, partial_of(recording))

    def _documents(self, found: Found) -> list[Document]:
        return [capture_document(entry, word) | {"partial_planes": self._left(entry, word)} for entry, word in found]

    def _withdraw(self, capture_id: str) -> None:
        """Cancel a recording that was never begun; what a worker that died has begun, the next one finishes."""
        if self._store.folder.begun(capture_id).exists():
            return
        entry = self._store.entries.get("capture", capture_id)
        if entry.told == "new":  # it was kept by a process that died, and would be queued again
            self._queue.start(entry)
        self._store.events.progress(capture_id, Progress(stage=entry.type, message=NEVER_BEGUN).model_dump())
        self._engine.withdraw(capture_id)

    def _ended(self, capture_id: str) -> Entry:
        """Return a capture that has ended, with its processes; raises StateError for any other."""
        entry = self._store.entries.get("capture", capture_id)
        status = self._engine.status(entry)
        if status in ACTIVE or is_locked(self._store.folder.entry(capture_id)):
            raise StateError(f"found {capture_id} {status}", "it ended", "stop it first")
        return entry

    def _left(self, entry: Entry | Listed, status: Status) -> int | None:
        return left_planes(self._store.folder.recording(entry.id)) if status == "failed" else None
