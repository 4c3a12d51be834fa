"""The state of rigs: preflights and looks are jobs, which never meet a recording; the status shows their results."""

import contextlib
import json
import shutil
from datetime import datetime

from rigs.rig import Rig
from server.engine import Engine, capture_queue
from server.errors import NotFoundError, StateError
from server.schemas.job_types import LookRequest, PreflightRequest
from server.schemas.progress import ACTIVE
from server.schemas.rigs import CameraState, Preflight, RigStatus, Room, Work
from server.services.captures import RigService
from server.services.jobs import JobService
from server.services.looks import LookService
from server.services.queue import Key, Queue
from server.services.space import tick_bytes
from server.store.entries import Filter
from server.store.store import Store

_LATEST = 20  # entries to look through for the newest that ended well


class RigJobService:
    """Preflights and looks, and the status of rigs. Its methods raise NotFoundError for an unknown rig."""

    def __init__(
        self,
        store: Store,
        engine: Engine,
        queue: Queue,
        rigs: RigService,
        jobs: JobService,
        looks: LookService,
    ) -> None:
        self._store = store
        self._engine = engine
        self._queue = queue
        self._rigs = rigs
        self._jobs = jobs
        self._looks = looks

    def start(self, rig_id: str, request: PreflightRequest | LookRequest, key: Key = None) -> str:
        """Queue a look at a rig; return its id. Raises RigBusyError while the rig is busy."""
        self._rigs.rig(rig_id)
        job_id, known = self._queue.once("job", request, key, f"{rig_id}:{request.type}")
        if known:
            return job_id
        queue = capture_queue(rig_id)
        entry = self._queue.entry("job", job_id, request, type=request.type, rig=rig_id, queue=queue)
        folder = self._store.folder.job(job_id)
        folder.mkdir(exist_ok=True)
        try:
            self._rigs.add_where_idle(entry)
        except Exception:
            self._store.folder.remove(folder)
            raise
        if request.type == "look":
            self._forget_older_looks(rig_id, job_id)
        return job_id

    def status(self, rig_id: str) -> RigStatus:
        """Return the state of a rig."""
        rig = self._rigs.rig(rig_id)
        preflight, facts = self._preflight(rig_id)
        shown = {
            "rig": rig_id,
            "worker": any(capture_queue(rig_id) in worker.queues for worker in self._store.workers.alive()),
            "busy": self._work(rig_id),
            "disk": self._room(rig),
            "calibration": self._store.calibrations.current(rig_id)[1],
            "preflight": preflight,
            "cameras": [
                CameraState.model_validate({"id": camera_id} | facts.get(camera_id, {})) for camera_id in rig.ids
            ],
            "look": self._looks.newest(rig_id),
        }
        return RigStatus.model_validate(shown, from_attributes=True)

    def _work(self, rig_id: str) -> Work | None:
        busy = self._engine.active(capture_queue(rig_id))
        found = self._store.entries.find([busy] if busy else [])
        if not found:
            return None
        known = {"fraction": 0.0, "message": "", **found[0].progress, "status": self._engine.status(found[0])}
        return Work.model_validate(vars(found[0]) | known)

    def _room(self, rig: Rig) -> Room:
        rate = tick_bytes(rig) * rig.tick_rate_hz
        free = shutil.disk_usage(self._store.folder.path).free
        return Room(free_bytes=free, bytes_per_s=rate, seconds=free / rate)

    def _preflight(self, rig_id: str) -> tuple[Preflight | None, dict[str, dict[str, object]]]:
        """Return the newest preflight that has an answer, and its measurements of each camera."""
        for entry in self._store.entries.page(Filter("job", "preflight", rig_id), _LATEST):
            with contextlib.suppress(OSError, ValueError, KeyError):  # under way, or failed
                result = json.loads((self._store.folder.out(entry.id) / "result.json").read_text())
                age_s = max(0.0, self._store.clock() - datetime.fromisoformat(entry.created).timestamp())
                known = {"job": entry.id, "created": entry.created, "age_s": age_s}
                return Preflight.model_validate(result | known), {camera["id"]: camera for camera in result["cameras"]}
        return None, {}

    def _forget_older_looks(self, rig_id: str, job_id: str) -> None:
        """Delete the older looks that ended: a page that looks every few seconds leaves one job, not thousands."""
        older = [e for e in self._store.entries.page(Filter("job", "look", rig_id), _LATEST) if e.id != job_id]
        status = self._engine.statuses(older)
        for entry in older:
            if status[entry.id] not in ACTIVE:
                with contextlib.suppress(NotFoundError, StateError):
                    self._jobs.delete(entry.id)
