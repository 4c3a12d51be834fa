"""How rigs are: looked at by jobs of their own, which never meet a recording, and told from what those found."""

from __future__ import annotations

import contextlib
import json
import shutil
import time
from collections.abc import Callable
from datetime import datetime

from acquisition.spikes.layout import PlaneLayout
from rigs.rig import Rig
from server.engine import Engine, capture_queue
from server.errors import NotFoundError, StateError
from server.schemas.job_types import LookRequest, PreflightRequest
from server.schemas.progress import ACTIVE
from server.schemas.rigs import CalibrationInUse, CameraState, Look, Preflight, RigStatus, Room, Work
from server.services.captures import RigService
from server.services.jobs import JobService
from server.services.previews import Picture
from server.services.queue import Key, Queue
from server.store.entries import Entry, Filter
from server.store.store import Store

_LATEST = 20  # entries to look through for the newest that ended well


class RigJobService:
    """Preflights and looks, and the status of rigs."""

    def __init__(
        self,
        store: Store,
        engine: Engine,
        queue: Queue,
        rigs: RigService,
        jobs: JobService,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._store = store
        self._engine = engine
        self._queue = queue
        self._rigs = rigs
        self._jobs = jobs
        self._clock = clock

    def start(self, rig_id: str, request: PreflightRequest | LookRequest, key: Key = None) -> str:
        """Queue a look at a rig; its id. Raises NotFoundError and, while the rig is busy, RigBusyError."""
        self._rigs.rig(rig_id)
        (job_id,) = self._queue.ids("job", [request], key, f"{rig_id}:{request.type}")
        if self._queue.known(job_id):
            return job_id
        entry = Entry(
            id=job_id,
            kind="job",
            type=request.type,
            created=self._store.entries.created(),
            request=request.model_dump(exclude={"name", "priority"}),
            rig=rig_id,
            name=request.name,
            queue=capture_queue(rig_id),
            priority=request.priority,
        )
        self._store.folder.job(job_id).mkdir(exist_ok=True)
        try:
            self._rigs.add_where_idle(rig_id, entry)
        except Exception:
            self._store.folder.remove(self._store.folder.job(job_id))
            raise
        if request.type == "look":
            self._forget_older_looks(rig_id, job_id)
        return job_id

    def picture(self, rig_id: str) -> Picture:
        """What the cameras saw at the last look; raises NotFoundError before the first."""
        self._rigs.rig(rig_id)
        path = self._store.folder.rig(rig_id) / "look.png"
        try:
            return Picture.of(path.read_bytes())
        except FileNotFoundError as error:
            raise NotFoundError(
                f"found no picture of rig {rig_id}", "a look before", f"POST /v1/rigs/{rig_id}/look makes one"
            ) from error

    def status(self, rig_id: str) -> RigStatus:
        """How a rig is; raises NotFoundError."""
        rig = self._rigs.rig(rig_id)
        preflight, facts = self._preflight(rig_id)
        _, calibration = self._store.calibrations.current(rig_id)
        return RigStatus(
            rig=rig_id,
            worker=any(capture_queue(rig_id) in worker.queues for worker in self._store.workers.alive()),
            busy=self._work(rig_id),
            disk=self._room(rig),
            calibration=calibration
            and CalibrationInUse(version=calibration.version, source=calibration.source, created=calibration.created),
            preflight=preflight,
            cameras=[CameraState.model_validate({"id": camera_id} | facts.get(camera_id, {})) for camera_id in rig.ids],
            look=self._look(rig_id),
        )

    def _work(self, rig_id: str) -> Work | None:
        busy = self._engine.active(capture_queue(rig_id))
        found = self._store.entries.find([busy] if busy else [])
        if not found:
            return None
        (entry,) = found
        progress = entry.progress
        return Work(
            id=entry.id,
            type=entry.type,
            status=self._engine.statuses(found)[entry.id],
            fraction=progress.get("fraction", 0.0),
            message=progress.get("message", ""),
        )

    def _room(self, rig: Rig) -> Room:
        plane_bytes = sum(PlaneLayout(camera.width, camera.height).plane_bytes for camera in rig.cameras)
        rate = plane_bytes * rig.tick_rate_hz
        free = shutil.disk_usage(self._store.folder.path).free
        return Room(free_bytes=free, bytes_per_s=rate, seconds=free / rate)

    def _preflight(self, rig_id: str) -> tuple[Preflight | None, dict[str, dict[str, object]]]:
        """The newest preflight that has an answer, and what it measured of each camera."""
        for entry in self._store.entries.page(Filter("job", "preflight", rig_id), _LATEST):
            with contextlib.suppress(OSError, ValueError, KeyError):  # under way, or failed
                result = json.loads((self._store.folder.out(entry.id) / "result.json").read_text())
                age_s = self._clock() - datetime.fromisoformat(entry.created).timestamp()
                found = Preflight(
                    job=entry.id,
                    created=entry.created,
                    age_s=max(0.0, age_s),
                    ready=result["ready"],
                    checks=result["checks"],
                )
                return found, {camera["id"]: camera for camera in result["cameras"]}
        return None, {}

    def _look(self, rig_id: str) -> Look | None:
        path = self._store.folder.rig(rig_id) / "look.png"
        if not path.exists():
            return None
        return Look(age_s=max(0.0, self._clock() - path.stat().st_mtime), etag=self.picture(rig_id).etag)

    def _forget_older_looks(self, rig_id: str, job_id: str) -> None:
        """A page that looks every few seconds leaves one job, not thousands."""
        older = [e for e in self._store.entries.page(Filter("job", "look", rig_id), _LATEST) if e.id != job_id]
        status = self._engine.statuses(older)
        for entry in older:
            if status[entry.id] not in ACTIVE:
                with contextlib.suppress(NotFoundError, StateError):
                    self._jobs.delete(entry.id)
