"""The job engine as the service uses it: names, queues, and the questions and orders of a client."""

from collections.abc import Mapping, Sequence
from typing import Any

import sqlalchemy as sa
from dbos import DBOSClient, DBOSPortableJSONSerializer, EnqueueOptions
from dbos import error as engine_errors

from reconstruction.run.configuration import FOLLOW, STAGES
from server.errors import StateError
from server.pickles import refuse_pickles
from server.schemas.progress import ENDED, Status
from server.settings import ServiceSettings
from server.store.engine_tables import PART, WORKFLOW, EngineTables, Place
from server.store.entries import Listed, Open
from server.store.tables import Entry

APPLICATION = "spike4dgs"
# Steps are replayed by position, and travel with an entry: change this when what travels with one of old is read anew.
APPLICATION_VERSION = "3"

PARTS = "parts"  # the step, before the training, that hands out its parts
RECONSTRUCTIONS = "reconstructions"  # queue of trainings and of their parts: one at a time a worker
TASKS = "tasks"  # queue of work that takes a processor for seconds or minutes
_CONNECTIONS = 20  # as many as half the web process's threads
_STATUS: dict[str, Status] = {
    "ENQUEUED": "queued",
    "DELAYED": "queued",
    "PENDING": "running",
    "SUCCESS": "done",
    "CANCELLED": "cancelled",
}
_QUEUED = ("ENQUEUED", "DELAYED")
Queued = Entry | Listed | Open


def stages_of(entry_type: str, request: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the stages of a request, in order."""
    if entry_type != "reconstruct":
        return (entry_type,)
    return (FOLLOW, *STAGES) if request.get("follow") else STAGES


def steps_of(entry_type: str, request: Mapping[str, Any]) -> list[str]:
    """Return the steps of a request, in order: its stages and, before a training, the handing out of its parts."""
    stages = stages_of(entry_type, request)
    return [step for stage in stages for step in ((PARTS, stage) if stage == "train" else (stage,))]


def priority_of(entry: Entry, *, part: bool = False) -> int:
    """Return the engine's priority of an entry or of a part of it: after all entries of the same priority."""
    return 2 * max(entry.priority, 1) + part


def part_id(entry_id: str, attempt: int, name: str = "") -> str:
    """Return the id of the work on a part of a job in one of its attempts; without a name, what all ids begin with."""
    return f"{entry_id}.{attempt}.{name}"


def entry_of(workflow_id: str) -> str:
    """Return the entry that a workflow belongs to: itself, or the job that it is a part of."""
    return workflow_id.partition(".")[0]


def capture_queue(rig_id: str) -> str:
    """Return the queue of recordings with a rig."""
    return f"captures-{rig_id}"


class Engine:
    """A client of the job engine; entries are workflows of the same id."""

    def __init__(self, settings: ServiceSettings) -> None:
        refuse_pickles()
        self._client = DBOSClient(
            system_database_url=settings.engine_url,
            system_database_pool_size=_CONNECTIONS,
            serializer=DBOSPortableJSONSerializer(),
            application_name=APPLICATION,
            retry_connection_errors=False,  # the caller is told, rather than kept waiting for the database
        )
        self._tables = EngineTables(settings, RECONSTRUCTIONS)

    @property
    def client(self) -> DBOSClient:
        """The client of the job engine itself."""
        return self._client

    @property
    def tables(self) -> EngineTables:
        """The reader of the job engine's tables."""
        return self._tables

    def close(self) -> None:
        """Let go of the database."""
        self._client.destroy()
        self._tables.close()

    def check(self) -> None:
        """Raise where the database does not answer."""
        self._client.check_connection()

    def enqueue(self, entry: Entry) -> None:
        """Queue an entry; one that is queued already stays as it is."""
        assert entry.queue is not None
        options: EnqueueOptions = {
            "workflow_name": WORKFLOW,
            "queue_name": entry.queue,
            "workflow_id": entry.id,
            "app_version": APPLICATION_VERSION,
            "priority": priority_of(entry),
        }
        self._client.enqueue(options, entry.id, steps_of(entry.type, entry.request))

    def status(self, entry: Queued) -> Status:
        """Return the status of one entry, as `statuses` does."""
        return self.statuses([entry])[entry.id]

    def statuses(self, entries: Sequence[Queued]) -> dict[str, Status]:
        """Return the status of each entry; one without work is done, one that is yet to be queued is queued.

        One that has ended keeps its end where the engine has lost its memory of it.
        """
        known = self.known(entries)
        ends: dict[str, Status] = {entry.id: word for entry in entries for word in ENDED if word == entry.told}
        return {entry_id: status or ends.get(entry_id, "queued") for entry_id, status in known.items()}

    def known(self, entries: Sequence[Queued]) -> dict[str, Status | None]:
        """Return the same, but None for an entry with a queue that the engine does not know, or no longer."""
        found = self._tables.statuses([entry.id for entry in entries if entry.queue is not None])
        known: dict[str, Status] = {entry_id: _STATUS.get(status, "failed") for entry_id, status in found.items()}
        return {entry.id: known.get(entry.id) if entry.queue else "done" for entry in entries}

    def active(self, queue: str) -> str | None:
        """Return an entry of the queue that is queued or running, if any."""
        found = self._client.list_workflows(
            queue_name=queue, status=["ENQUEUED", "PENDING"], limit=1, load_input=False, load_output=False
        )
        return found[0].workflow_id if found else None

    def count(self) -> dict[tuple[str, Status], int]:
        """Return how many entries of each queue are queued or running."""
        found = self._tables.count(["ENQUEUED", "PENDING"])
        return {(queue, _STATUS[status]): number for (queue, status), number in found.items()}

    def places(self) -> list[Place]:
        """Return the entries that run or are queued, in the order in which workers take them."""
        return self._tables.places(["ENQUEUED", "PENDING"], "PENDING")

    def running(self) -> dict[str, str]:
        """Return the id of every entry and part that a worker has, and the worker."""
        found = self._client.list_workflows(status="PENDING", load_input=False, load_output=False)
        return {one.workflow_id: one.executor_id or "" for one in found}

    def ended(self) -> list[str]:
        """Return all entries the engine remembers, of themselves or of parts, that are neither queued nor running."""
        found = self._client.list_workflows(
            name=[WORKFLOW, PART], status=["SUCCESS", "ERROR", "CANCELLED"], load_input=False, load_output=False
        )
        return list(dict.fromkeys(entry_of(one.workflow_id) for one in found))

    def cancel(self, entry_id: str) -> None:
        """Stop an entry that is queued or running, and its parts."""
        self._client.cancel_workflow(entry_id)
        self._client.cancel_workflows(self._parts(entry_id))

    def withdraw(self, entry_id: str) -> None:
        """Stop an entry that is queued; one that a worker has taken meanwhile goes on.

        In one statement, which the engine does not have: its own also cancels what is running.
        """
        system = self._client._sys_db
        table, now = system.tables.workflow_status, system._now_ms_sql()
        is_queued = sa.and_(table.c.workflow_uuid == entry_id, table.c.status.in_(_QUEUED))
        ends = {"status": "CANCELLED", "queue_name": None, "updated_at": now, "completed_at": now}
        with system.engine.begin() as connection:
            connection.execute(sa.update(table).where(is_queued).values(**ends))

    def adopt(self, workflow_id: str, worker: str, queue: str) -> None:
        """Take an entry or part from its worker, where it still runs there, and queue it again where it stopped.

        In one statement: cancelling and resuming would leave it cancelled if this process died in between, and would
        undo what a client has cancelled meanwhile.
        """
        self._client._sys_db.reenqueue_for_recovery(workflow_id, [worker], queue)

    def rewind(self, entry: Entry, stage: str | None = None) -> None:
        """Queue an ended entry again, from `stage` on or from the one it stopped in.

        Parts that failed or were stopped are handed out again before the training goes on.
        """
        steps = self._client.list_workflow_steps(entry.id)
        known = {step["function_name"]: step["function_id"] for step in steps}
        start = len(steps) + 1
        if stage is None:
            start = next((step["function_id"] for step in steps if step["error"]), start)
        else:
            start = known.get(stage, start)
        if start - 1 == known.get(PARTS):
            start -= 1
        try:
            self._client.rewind_workflow(
                entry.id, start_step=start, application_version=APPLICATION_VERSION, queue_name=entry.queue
            )
        except engine_errors.DBOSException as error:  # another request was faster
            raise StateError(f"found {entry.id} queued or deleted meanwhile", "it ended", "look again") from error

    def forget(self, entry_id: str) -> None:
        """Delete the engine's memory of an entry and its parts."""
        self._client.delete_workflows([entry_id, *self._parts(entry_id)])

    def _parts(self, entry_id: str) -> list[str]:
        return list(self._tables.beginning_with(f"{entry_id}."))
