"""The job engine as parts of trainings use it: handed out, looked up, and waited for without holding a worker."""

from collections.abc import Iterable, Mapping

import sqlalchemy as sa
from dbos import EnqueueOptions
from dbos import error as engine_errors

from server.engine import APPLICATION_VERSION, RECONSTRUCTIONS, Engine, entry_of, part_id, priority_of
from server.schemas.progress import ACTIVE
from server.store.engine_tables import PART, WAITING
from server.store.tables import Entry

_AT_WORK = ("ENQUEUED", "DELAYED", "PENDING")


def attempt_of(entry: Entry) -> int:
    """Return how often a job was told to begin again."""
    return 0 if entry.restart is None else entry.restart["attempt"]


class PartQueue:
    """The parts of jobs: work of its own each, under an id that is made of job, attempt and name.

    A job that waits for its parts lies in a queue that no worker serves, so it keeps nobody from working.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._tables = engine.tables

    def hand_out(self, entry: Entry, names: Iterable[str]) -> None:
        """Queue parts, behind all jobs of the priority; one that is queued or over already stays as it is."""
        attempt = attempt_of(entry)
        for name in names:
            options: EnqueueOptions = {
                "workflow_name": PART,
                "queue_name": RECONSTRUCTIONS,
                "workflow_id": part_id(entry.id, attempt, name),
                "app_version": APPLICATION_VERSION,
                "priority": priority_of(entry, part=True),
            }
            self._engine.client.enqueue(options, entry.id, attempt, name)

    def try_again(self, entry: Entry, names: Iterable[str]) -> None:
        """Queue ended parts again, as if they had never begun."""
        for name in names:
            workflow_id = part_id(entry.id, attempt_of(entry), name)
            try:
                self._engine.client.rewind_workflow(
                    workflow_id, start_step=1, application_version=APPLICATION_VERSION, queue_name=RECONSTRUCTIONS
                )
            except engine_errors.DBOSException:  # another worker was faster
                continue

    def states(self, entry: Entry) -> dict[str, str]:
        """Return the engine's own word for the state of the parts of a job that it knows, by name."""
        prefix = part_id(entry.id, attempt_of(entry))
        return {found.removeprefix(prefix): word for found, word in self._tables.beginning_with(prefix).items()}

    def reason(self, entry: Entry, name: str) -> str:
        """Return why a part failed, in the words of the worker that it failed on."""
        workflow_id = part_id(entry.id, attempt_of(entry), name)
        found = self._engine.client.list_workflows(workflow_ids=[workflow_id], load_input=False)
        return str(found[0].error) if found and found[0].error else "it was stopped"

    def is_active(self, entry: Entry) -> bool:
        """Return whether a job is queued, runs or waits for its parts."""
        return self._engine.status(entry) in ACTIVE

    def park(self, entry_id: str, worker: str) -> None:
        """Let a job wait for its parts, where it still runs on this worker, and hold no place on it meanwhile.

        In one statement, which the engine does not have: cancelling and resuming would undo what a client has cancelled
        meanwhile, and could be interrupted half-way.
        """
        away = {"status": "ENQUEUED", "queue_name": WAITING, "owner_xid": None, "started_at_epoch_ms": None}
        self._move(entry_id, {"status": "PENDING", "executor_id": worker}, away)

    def wake(self, entry_id: str) -> None:
        """Queue a job that waits for its parts, before all that came later; any other stays as it is."""
        self._move(entry_id, {"status": "ENQUEUED", "queue_name": WAITING}, {"queue_name": RECONSTRUCTIONS})

    def forgotten(self) -> list[str]:
        """Return the jobs that wait for parts of which none is queued or running."""
        waiting = self._tables.waiting()
        at_work = {entry_of(found) for found in self._tables.parts_at_work()} if waiting else ()
        return [entry_id for entry_id in waiting if entry_id not in at_work]

    def _move(self, entry_id: str, where: Mapping[str, str], changes: dict[str, str | None]) -> None:
        """Change the columns of a job where it has other columns as they are in `where`."""
        system = self._engine.client._sys_db
        table = system.tables.workflow_status
        mine = [table.c.workflow_uuid == entry_id, *(table.c[name] == value for name, value in where.items())]
        with system.engine.begin() as connection:
            connection.execute(sa.update(table).where(*mine).values(**changes, updated_at=system._now_ms_sql()))


def is_at_work(word: str) -> bool:
    """Return whether the engine's own word for a state is one of work that is queued or runs."""
    return word in _AT_WORK


def is_lost(word: str) -> bool:
    """Return whether it is one of work that failed or was stopped."""
    return word not in _AT_WORK and word != "SUCCESS"
