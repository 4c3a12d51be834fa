"""Jobs: queued one by one or together, cancelled, resumed, restarted, listed and deleted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rigs.toml import load_rig
from server.engine import RECONSTRUCTIONS, TASKS, Engine, stages_of
from server.errors import NotFoundError, RigMismatchError, StateError, UnknownReferenceError
from server.schemas.job_types import (
    JOB_TYPES,
    RIG_JOB_TYPES,
    CalibrateRequest,
    CheckRigRequest,
    ExportRequest,
    JobBase,
    OfCapture,
    OfJob,
    ReconstructRequest,
    RenderRequest,
)
from server.schemas.jobs import Job, Steps
from server.schemas.progress import ACTIVE, Status
from server.services.captures import RigService
from server.services.listing import job_document, page_of
from server.services.queue import Key, Queue
from server.store.entries import Entry, Filter
from server.store.files import is_locked
from server.store.rig_files import fitted
from server.store.store import Store


class JobService:
    """The jobs of a service."""

    def __init__(self, store: Store, engine: Engine, queue: Queue, rigs: RigService) -> None:
        self._store = store
        self._engine = engine
        self._queue = queue
        self._rigs = rigs

    def submit(self, requests: Sequence[JobBase], key: Key = None) -> list[str]:
        """Queue jobs, all of them or none; their ids.

        Raises UnknownReferenceError, StateError before what they work on is done, RigError for a camera it lacks,
        RigMismatchError for a rig of other cameras, and IdempotencyError.
        """
        ids = self._queue.ids("job", requests, key, "jobs")
        pairs = zip(ids, requests, strict=True)
        self.add({job_id: request for job_id, request in pairs if not self._queue.known(job_id)})
        return ids

    def add(self, requests: Mapping[str, JobBase], *, waits: bool = False) -> None:
        """Queue new jobs under ids that nobody has; raises as `submit` does.

        Those that wait are kept, and queued by the announcer when their capture is made.
        """
        entries = [self._entry(job_id, request, waits) for job_id, request in requests.items()]
        for entry in entries:
            self._store.folder.job(entry.id).mkdir(exist_ok=True)
            if waits:
                self._store.entries.add(entry)
            else:
                self._queue.add(entry)

    def get(self, job_id: str) -> Job:
        """One job; raises NotFoundError."""
        return self._shown([self._store.entries.get("job", job_id)])[0]

    def page(self, wanted: Filter, status: Status | None = None, limit: int = 100) -> bytes:
        """A page of jobs, newest first: `Jobs` as JSON."""
        return page_of(self._store, self._engine, wanted, status, limit, job_document)

    def steps(self, job_id: str) -> Steps:
        """The stages of a job and how far each is; raises NotFoundError."""
        job = self.get(job_id)
        names = stages_of(job.type)
        at = len(names) if job.status == "done" else names.index(job.stage) if job.stage in names else 0
        here = {"running": "running", "failed": "failed"}.get(job.status, "waiting")
        words = ["done" if i < at else here if i == at else "waiting" for i in range(len(names))]
        rows = zip(names, words, strict=True)
        return Steps.model_validate(
            {"items": [{"stage": name, "status": word, "seconds": job.seconds.get(name)} for name, word in rows]}
        )

    def cancel(self, job_id: str) -> Job:
        """Stop a job that is queued or running; raises NotFoundError, StateError."""
        self._expect(self.get(job_id), *ACTIVE)
        entry = self._store.entries.get("job", job_id)
        if entry.told == "new":  # it waits for its capture, or was kept by a process that died: not queued yet
            self._queue.start(entry)
        self._engine.cancel(job_id)
        return self.get(job_id)

    def resume(self, job_id: str) -> Job:
        """Queue a failed or cancelled job again from the stage it stopped in; raises NotFoundError, StateError."""
        self._rewind(self._ended(job_id, "failed", "cancelled"), None)
        return self.get(job_id)

    def restart(self, job_id: str, stage: str) -> Job:
        """Queue an ended job again from `stage` on, whose results and later ones are forgotten.

        Raises NotFoundError, StateError, UnknownReferenceError where the job has no such stage or never reached it.
        """
        entry = self._ended(job_id, "done", "failed", "cancelled")
        stages = stages_of(entry.type)
        reached = self.get(job_id).stage
        begun = stages[: stages.index(reached) + 1] if reached in stages else ()
        if stage not in begun:
            raise UnknownReferenceError(
                f"found the stage {stage}", f"one that {job_id} has begun: {', '.join(begun) or 'none yet'}"
            )
        attempt = (entry.restart or {}).get("attempt", 0) + 1
        self._store.entries.change(job_id, restart={"stage": stage, "attempt": attempt})
        self._rewind(entry, stage)
        return self.get(job_id)

    def prioritise(self, job_id: str, priority: int) -> Job:
        """Give a queued job another priority; raises NotFoundError, StateError."""
        self._expect(self.get(job_id), "queued")
        entry = self._store.entries.get("job", job_id)
        if entry.told == "new":
            self._store.entries.change(job_id, priority=priority)
        else:
            self._queue.prioritise(entry, priority)
        return self.get(job_id)

    def delete(self, job_id: str) -> None:
        """Delete a job and what it made; raises NotFoundError, and StateError while it is at work."""
        self._ended(job_id, "done", "failed", "cancelled")
        using = [entry.id for entry in self._queue.at_work() if entry.request.get("job") == job_id]
        if using:
            raise StateError(f"found {job_id} in use by {using[0]}", "no job at work on it", "cancel it")
        self._store.entries.remove(job_id)  # first: what is kept and not queued is queued again
        self._engine.forget(job_id)
        folder = self._store.folder
        folder.remove(folder.job(job_id))
        folder.remove(folder.entry(job_id))

    def log(self, job_id: str, first_line: int = 0) -> str:
        """What the job's stages wrote, from a line on; raises NotFoundError."""
        path = self._store.folder.log(self._store.entries.get("job", job_id).id)
        text = path.read_text(errors="replace") if path.exists() else ""
        return "".join(text.splitlines(keepends=True)[first_line:])

    def _rewind(self, entry: Entry, stage: str | None) -> None:
        self._tell_queued(entry)  # first, so that the announcer looks at it even if this process dies on the way
        self._engine.rewind(entry, stage)
        self._tell_queued(entry)  # again, where the announcer has looked too early

    def _tell_queued(self, entry: Entry) -> None:
        told = self._store.entries.get("job", entry.id).told
        if told not in ACTIVE:
            self._store.events.tell(entry.id, told, "queued", {})

    def _ended(self, job_id: str, *states: Status) -> Entry:
        self._expect(self.get(job_id), *states)
        if is_locked(self._store.folder.entry(job_id)):
            raise StateError(f"found {job_id} still stopping", "it stopped", "try again in a few seconds")
        return self._store.entries.get("job", job_id)

    @staticmethod
    def _expect(job: Job, *states: Status) -> None:
        if job.status not in states:
            raise StateError(f"found {job.id} {job.status}", f"it {' or '.join(states)}")

    def _entry(self, job_id: str, request: JobBase, waits: bool) -> Entry:
        target = self._target(request, waits)
        kind = request.model_dump()["type"]
        return Entry(
            id=job_id,
            kind="job",
            type=kind,
            created=self._store.entries.created(),
            request=request.model_dump(exclude={"name", "priority"}),
            rig=target.rig,
            capture=target.id if target.kind == "capture" else target.capture,
            name=request.name,
            queue=RECONSTRUCTIONS if kind == "reconstruct" else TASKS,
            priority=request.priority,
        )

    def _target(self, request: JobBase, waits: bool) -> Entry:
        """What a job works on: done, unless the job waits for it, and fit for it."""
        try:
            if isinstance(request, OfJob):
                target = self._store.entries.get("job", request.job)
                if target.type != "reconstruct":
                    raise UnknownReferenceError(f"found the job {target.id} of type {target.type}", "reconstruct")
            else:
                assert isinstance(request, OfCapture)
                target = self._store.entries.get("capture", request.capture)
        except NotFoundError as error:
            raise UnknownReferenceError(str(error)) from error
        if not waits:
            self._expect_done(target)
            self._check_cameras(request, target)
            self._check_rig(request, target)
        if isinstance(request, RenderRequest):
            self._store.uploads.committed(request.cameras)
        return target

    def _expect_done(self, target: Entry) -> None:
        status = self._engine.statuses([target])[target.id]
        if status != "done":
            raise StateError(f"found {target.kind} {target.id} {status}", "it done", "wait for it")

    def _check_rig(self, request: JobBase, target: Entry) -> None:
        """A rig is calibrated and checked with captures of its own cameras."""
        if not isinstance(request, (CalibrateRequest, CheckRigRequest)):
            return
        captures = [target]
        try:
            rig = None if request.rig is None else self._rigs.rig(request.rig)
            if isinstance(request, CalibrateRequest) and request.dark is not None:
                captures.append(self._store.entries.get("capture", request.dark))
        except NotFoundError as error:
            raise UnknownReferenceError(str(error)) from error
        for capture in captures:
            self._expect_done(capture)
            if rig is None:
                continue
            if capture.rig not in (None, request.rig):
                raise RigMismatchError(f"found {capture.id} of rig {capture.rig}", f"one of {request.rig}")
            fitted(load_rig(self._store.folder.recording(capture.id) / "rig.toml"), rig)

    def _check_cameras(self, request: JobBase, target: Entry) -> None:
        named: list[str | None] = []
        if isinstance(request, ReconstructRequest):
            named = [request.holdout, *(request.views or [])]
        elif isinstance(request, ExportRequest):
            named = [request.camera]
        wanted = [camera for camera in named if camera is not None]
        capture = target.id if target.kind == "capture" else target.capture
        if wanted and capture is not None:
            rig = load_rig(self._store.folder.recording(capture) / "rig.toml")
            for camera in wanted:
                rig.camera(camera)

    def _shown(self, entries: Sequence[Entry]) -> list[Job]:
        status = self._engine.statuses(entries)
        return [
            Job(
                id=entry.id,
                type=entry.type,
                created=entry.created,
                status=status[entry.id],
                priority=entry.priority,
                name=entry.name,
                request=(JOB_TYPES | RIG_JOB_TYPES)[entry.type].model_validate(entry.request),  # type: ignore[arg-type]
                rig=entry.rig,
                **entry.progress,
            )
            for entry in entries
        ]
