"""Captures: started, stopped, listed and deleted."""

from __future__ import annotations

import threading
from collections.abc import Sequence

from rigs.rig import Rig
from server.engine import Engine, capture_queue
from server.errors import NotFoundError, RigBusyError, StateError
from server.schemas.captures import Capture, CaptureRequest
from server.schemas.progress import ACTIVE, Status
from server.schemas.rigs import CameraInfo, RigInfo, Rigs
from server.services.listing import capture_document, page_of
from server.services.queue import Key, Queue
from server.settings import RigSource
from server.store.entries import Entry, Filter
from server.store.files import is_locked
from server.store.store import Store


class RigService:
    """The rigs, and the captures they are told to make. Raises RigError for a rig that cannot be loaded."""

    def __init__(self, store: Store, engine: Engine, queue: Queue, sources: dict[str, RigSource]) -> None:
        self._store = store
        self._engine = engine
        self._queue = queue
        self._sources = sources
        self.rigs: dict[str, Rig] = {rig_id: source.load() for rig_id, source in sources.items()}
        self._one_at_a_time = threading.Lock()

    def list(self) -> Rigs:
        """All rigs."""
        return Rigs(items=[self.get(rig_id) for rig_id in self.rigs])

    def rig(self, rig_id: str) -> Rig:
        """A rig as it is described; raises NotFoundError."""
        if rig_id not in self.rigs:
            raise NotFoundError(f"found no rig {rig_id[:60]}", f"one of {', '.join(self.rigs)}")
        return self.rigs[rig_id]

    def get(self, rig_id: str) -> RigInfo:
        """One rig; raises NotFoundError."""
        rig = self.rig(rig_id)
        current, stored = self._store.calibrations.current(rig_id)
        return RigInfo(
            id=rig_id,
            name=rig.name,
            tick_rate_hz=rig.tick_rate_hz,
            poses=stored.poses if stored else rig.poses,
            calibration=current.version,
            devices=self._sources[rig_id].devices,
            cameras=[CameraInfo(id=camera.id, width=camera.width, height=camera.height) for camera in rig.cameras],
            busy=self._engine.active(capture_queue(rig_id)),
        )

    def start(self, rig_id: str, request: CaptureRequest, key: Key = None) -> str:
        """Queue a recording; its id. Raises NotFoundError and, while the rig is busy, RigBusyError."""
        self.rig(rig_id)
        (capture_id,) = self._queue.ids("capture", [request], key, rig_id)
        if self._queue.known(capture_id):
            return capture_id
        entry = Entry(
            id=capture_id,
            kind="capture",
            type="record",
            created=self._store.entries.created(),
            request=request.model_dump(exclude={"name"}),
            rig=rig_id,
            name=request.name,
            queue=capture_queue(rig_id),
        )
        self.add_where_idle(rig_id, entry)
        return capture_id

    def add_where_idle(self, rig_id: str, entry: Entry) -> None:
        """Queue what uses a rig's cameras; raises RigBusyError while anything else does."""
        with self._one_at_a_time:
            busy = self._engine.active(capture_queue(rig_id))
            if busy is not None:
                raise RigBusyError(f"found rig {rig_id} busy with {busy}", "it idle", "wait for that to end")
            self._queue.add(entry)


class CaptureService:
    """The captures themselves, however they came."""

    def __init__(self, store: Store, engine: Engine, queue: Queue) -> None:
        self._store = store
        self._engine = engine
        self._queue = queue

    def get(self, capture_id: str) -> Capture:
        """One capture; raises NotFoundError."""
        return self._shown([self._store.entries.get("capture", capture_id)])[0]

    def page(self, wanted: Filter, status: Status | None = None, limit: int = 100) -> bytes:
        """A page of captures, newest first: `Captures` as JSON."""
        return page_of(self._store, self._engine, wanted, status, limit, capture_document)

    def tell(self, capture_id: str, word: str) -> Capture:
        """`stop` a capture, or `save` what its pre-trigger kept; raises NotFoundError, StateError."""
        capture = self.get(capture_id)
        if capture.status not in ACTIVE or capture.type != "record":
            raise StateError(f"found {capture.id} {capture.status}", "it recording")
        if capture.status == "queued" and word == "stop":
            self._engine.cancel(capture_id)
        else:
            (self._store.folder.entry(capture_id) / word).touch()
        return self.get(capture_id)

    def cancel(self, capture_id: str) -> Capture:
        """Give up an import that is queued or running; raises NotFoundError, StateError."""
        capture = self.get(capture_id)
        if capture.status not in ACTIVE or capture.type != "import":
            raise StateError(
                f"found {capture.id}, of type {capture.type}, {capture.status}",
                "an import at work",
                "a recording is stopped",
            )
        self._engine.cancel(capture_id)
        return self.get(capture_id)

    def log(self, capture_id: str) -> str:
        """What making a capture said, its doubts among it; raises NotFoundError."""
        path = self._store.folder.log(self._store.entries.get("capture", capture_id).id)
        return path.read_text(errors="replace") if path.exists() else ""

    def delete(self, capture_id: str) -> None:
        """Delete a capture and its recording; raises NotFoundError, and StateError while it is in use."""
        capture = self.get(capture_id)
        folder = self._store.folder
        if capture.status in ACTIVE or is_locked(folder.entry(capture_id)):
            raise StateError(f"found {capture.id} {capture.status}", "it ended", "stop it first")
        using = [e.id for e in self._queue.at_work() if e.kind == "job" and e.capture == capture_id]
        if using:
            raise StateError(f"found {capture.id} in use by {using[0]}", "no job at work on it", "cancel it")
        self._store.entries.remove(capture_id)  # first: what is kept and not queued is queued again
        self._engine.forget(capture_id)
        folder.remove(folder.recording(capture_id))
        folder.remove(folder.entry(capture_id))

    def _shown(self, entries: Sequence[Entry]) -> list[Capture]:
        status = self._engine.statuses(entries)
        return [
            Capture(
                id=entry.id,
                type=entry.type,
                rig=entry.rig,
                ticks=entry.request.get("ticks"),
                name=entry.name,
                created=entry.created,
                status=status[entry.id],
                **entry.progress,
            )
            for entry in entries
        ]
