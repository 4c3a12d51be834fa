"""Jobs: queued one by one or together, cancelled, resumed, restarted, listed and deleted."""

from collections.abc import Mapping, Sequence

from server.engine import RECONSTRUCTIONS, TASKS, Engine, stages_of
from server.errors import StateError, UnknownReferenceError
from server.schemas.captures import Labels
from server.schemas.job_types import JOB_TYPES, RIG_JOB_TYPES, JobBase
from server.schemas.jobs import Job, Jobs, Order, Steps
from server.schemas.progress import ACTIVE, ENDED, Status
from server.services.admission import Admission
from server.services.forecast import Forecast, Outlook
from server.services.listing import Document, Found, is_resumable, job_document, page_of, without_old_error
from server.services.queue import Key, Queue
from server.services.results import listable
from server.services.work_order import page_in_work_order
from server.store.entries import Filter
from server.store.store import Store
from server.store.tables import Entry


class JobService:
    """The jobs of a service."""

    def __init__(self, store: Store, engine: Engine, queue: Queue, admission: Admission) -> None:
        self._store = store
        self._engine = engine
        self._queue = queue
        self._admission = admission
        self._forecast = Forecast(store, engine)

    def submit(self, requests: Sequence[JobBase], key: Key = None) -> list[str]:
        """Queue jobs, all of them or none; return their ids. Raises as `Admission.target`, and IdempotencyError."""
        ids = self._queue.ids("job", requests, key, "jobs")
        known = {entry.id for entry in self._store.entries.find(ids)}
        pairs = zip(ids, requests, strict=True)
        self.add({job_id: request for job_id, request in pairs if job_id not in known})
        return ids

    def add(self, requests: Mapping[str, JobBase], *, waits: bool = False) -> None:
        """Queue new jobs under ids that nobody has; raises as `Admission.target`.

        Those that wait are kept, and queued by the announcer when their capture is made; those that follow a capture,
        when it has begun.
        """
        entries = [self._entry(job_id, request, waits) for job_id, request in requests.items()]
        for entry in entries:
            self._store.folder.job(entry.id).mkdir(exist_ok=True)
        early = {e.id for e in entries if waits or (e.request.get("follow") and self._queue.waits(e))}
        self._store.entries.add_all([entry for entry in entries if entry.id in early])
        self._queue.add_all([entry for entry in entries if entry.id not in early])

    def get(self, job_id: str) -> Job:
        """Return one job; raises NotFoundError."""
        entry = self._store.entries.get("job", job_id)
        status = self._engine.status(entry)
        outlook = self._forecast.of([job_id]).get(job_id) if status in ACTIVE else None
        return _job(entry, status, outlook or Outlook())

    def find(self, job_ids: Sequence[str]) -> Jobs:
        """Return those of the jobs that exist, in the order of their ids, without their places and times."""
        entries = sorted(self._store.entries.find(job_ids), key=lambda entry: entry.id)
        states = self._engine.statuses(entries)
        return Jobs(items=[_job(entry, states[entry.id], Outlook()) for entry in entries])

    def page(self, wanted: Filter, status: Status | None = None, limit: int = 100, order: Order = "newest") -> bytes:
        """Return a page of jobs: `Jobs` as JSON. Raises UnknownReferenceError for a cursor of another order."""
        listed = page_in_work_order if order == "work" else page_of
        return listed(self._store, self._engine, wanted, status, limit, self._documents)

    def label(self, job_id: str, labels: Labels) -> Job:
        """Give a job another name or note; raises NotFoundError."""
        self._store.entries.label("job", job_id, labels.model_dump(exclude_unset=True))
        return self.get(job_id)

    def steps(self, job_id: str) -> Steps:
        """Return the stages of a job and how far each is; raises NotFoundError."""
        job = self.get(job_id)
        names = stages_of(job.type, job.request.model_dump())
        at = len(names) if job.status == "done" else names.index(job.stage) if job.stage in names else 0
        here = {"running": "running", "failed": "failed"}.get(job.status, "waiting")
        words = ["done" if i < at else here if i == at else "waiting" for i in range(len(names))]
        rows = zip(names, words, strict=True)
        return Steps.model_validate(
            {"items": [{"stage": name, "status": word, "seconds": job.seconds.get(name)} for name, word in rows]}
        )

    def cancel(self, job_id: str) -> Job:
        """Stop a job that is queued or running; raises NotFoundError, StateError."""
        entry = self._expected(job_id, *ACTIVE)
        if entry.told == "new":  # it waits for its capture, or was kept by a process that died: not queued yet
            self._queue.start(entry)
        self._engine.cancel(job_id)
        return self.get(job_id)

    def resume(self, job_id: str) -> Job:
        """Queue a failed or cancelled job again from the stage it stopped in; raises NotFoundError, StateError."""
        return self._again(self._expected(job_id, "failed", "cancelled"))

    def restart(self, job_id: str, stage: str) -> Job:
        """Queue an ended job again from `stage` on, whose results and later ones are forgotten.

        Raises NotFoundError, StateError, UnknownReferenceError where the job has no such stage or never reached it.
        """
        entry = self._expected(job_id, *ENDED)
        stages = stages_of(entry.type, entry.request)
        reached = entry.progress.get("stage")
        begun = stages[: stages.index(reached) + 1] if reached in stages else ()
        if stage not in begun:
            raise UnknownReferenceError(
                f"found the stage {stage}", f"one that {job_id} has begun: {', '.join(begun) or 'none yet'}"
            )
        attempt = (entry.restart or {}).get("attempt", 0) + 1
        # Warnings of stages that are kept come again.
        progress = entry.progress | {"stage": stage, "fraction": 0.0, "message": "", "warnings": []}
        self._store.entries.change(job_id, restart={"stage": stage, "attempt": attempt}, progress=progress)
        return self._again(entry, stage)

    def prioritise(self, job_id: str, priority: int) -> Job:
        """Give a queued job another priority; raises NotFoundError, StateError."""
        entry = self._expected(job_id, "queued")
        self._queue.prioritise(entry, priority)
        return self.get(job_id)

    def delete(self, job_id: str) -> None:
        """Delete a job and what it made; raises NotFoundError, and StateError while it is at work."""
        entry = self._expected(job_id, *ENDED)
        self._queue.expect_unused(job_id)
        self._queue.remove(entry, self._store.folder.job(job_id))

    def log(self, job_id: str, first_line: int = 0) -> str:
        """Return the log of a job's stages, from a line on; raises NotFoundError."""
        text = self._store.folder.logged(self._store.entries.get("job", job_id).id)
        return "".join(text.splitlines(keepends=True)[first_line:])

    def _documents(self, found: Found) -> list[Document]:
        outlooks = self._forecast.of([entry.id for entry, word in found if word in ACTIVE])
        blank = Outlook()
        return [job_document(entry, word) | outlooks.get(entry.id, blank)._asdict() for entry, word in found]

    def _again(self, entry: Entry, stage: str | None = None) -> Job:
        self._queue.again(entry, stage)
        return self.get(entry.id)

    def _expected(self, job_id: str, *states: Status) -> Entry:
        """Return a job that is in one of `states`; one that has ended has no process left."""
        entry = self._store.entries.get("job", job_id)
        status = self._engine.status(entry)
        if status not in states:
            raise StateError(f"found {job_id} {status}", f"it {' or '.join(states)}")
        if status in ENDED and self._store.folder.has_process(job_id):
            raise StateError(f"found {job_id} still stopping", "it stopped", "try again in a few seconds")
        return entry

    def _entry(self, job_id: str, request: JobBase, waits: bool) -> Entry:
        target = self._admission.target(request, waits=waits)
        if not waits:
            request = listable(self._store.folder, request, target)
        kind = request.model_dump()["type"]
        return self._queue.entry(
            "job",
            job_id,
            request,
            type=kind,
            rig=target.rig,
            capture=target.id if target.kind == "capture" else target.capture,
            queue=RECONSTRUCTIONS if kind == "reconstruct" else TASKS,
        )


def _job(entry: Entry, status: Status, outlook: Outlook) -> Job:
    request = (JOB_TYPES | RIG_JOB_TYPES)[entry.type].model_validate(entry.request)
    resumable = is_resumable(status, bad_input=entry.progress.get("bad_input", False))
    known = {"status": status, "request": request, "resumable": resumable} | without_old_error(status)
    return Job.model_validate(vars(entry) | entry.progress | known | outlook._asdict())
