"""The worker process: it beats to show that it lives, works on its queues, and inherits from workers that died."""

import logging
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from dbos import DBOS, DBOSConfig, DBOSPortableJSONSerializer, PortableWorkflowError, StepOptions
from dbos import error as engine_errors
from sqlalchemy.exc import SQLAlchemyError

from acquisition.errors import DiskError
from rigs.errors import Spike4dgsError
from server.engine import (
    APPLICATION,
    APPLICATION_VERSION,
    PARTS,
    RECONSTRUCTIONS,
    TASKS,
    Engine,
    capture_queue,
    part_id,
)
from server.errors import WorkerRunningError
from server.part_queue import PartQueue
from server.pickles import refuse_pickles
from server.settings import ServiceSettings
from server.store.database import is_outage, reason_of
from server.store.engine_tables import PART, WORKFLOW
from server.store.files import locked
from server.store.store import Store
from server.store.tables import Worker
from server.telemetry import configure_logs, engine_tracing
from server.work.heir import Heir
from server.work.part_reporter import STAGE
from server.work.parts import TRIES, PartFailedError, Parts
from server.work.stages import Stages
from server.work.supervisor import StoppedStageError

_POLL_S = 0.5
_ELSEWHERE = "is no longer owned by this execution"  # the engine's word on what waits for its parts, or was inherited


def run_worker(settings: ServiceSettings, name: str, kinds: Sequence[str], stop: threading.Event) -> None:
    """Work on `kinds` of queues (captures, reconstructions, tasks) until `stop` is set.

    Stages then running are stopped, and taken up again by the next worker of this `name` or, where others are alive,
    by one of them. Raises WorkerRunningError where another worker has the name, and DatabaseError.
    """
    with _exclusive(settings, name):
        while not stop.is_set():
            try:
                _serve(settings, name, kinds, stop)
            except SQLAlchemyError as error:  # lost while the worker was starting: it starts again, and waits for it
                if not is_outage(error):
                    raise
                logging.getLogger(__name__).warning("the worker starts again: %s", reason_of(error))


def _serve(settings: ServiceSettings, name: str, kinds: Sequence[str], stop: threading.Event) -> None:
    """Work until told to stop, or until the rigs are others and nothing is in hand."""
    store = Store(settings, pause=stop.wait)
    try:
        rigs = _rigs(settings, store, kinds, stop) if "captures" in kinds else []
        queues = [*map(capture_queue, rigs), *(name for name in (RECONSTRUCTIONS, TASKS) if name in kinds)]
        me = store.workers.enter(name, queues)
        stages, engine = Stages(settings, store), Engine(settings)
        try:
            _refresh(store, rigs)
            parts = Parts(store, PartQueue(engine), stages.processes, name)
            _launch(settings, stages, parts, name, queues)
            watched = rigs if "captures" in kinds and not settings.own_rigs else None
            _work(store, Heir(store, engine, me, stages.busy), parts, me, stop, watched)
        finally:
            logging.getLogger("dbos").setLevel(logging.ERROR)  # it warns of every stage that is stopped here
            DBOS.destroy()
            with suppress(SQLAlchemyError):  # a database that is gone will see it from the beats
                store.workers.leave(me)
            engine.close()
    finally:
        store.close()


def _rigs(settings: ServiceSettings, store: Store, kinds: Sequence[str], stop: threading.Event) -> list[str]:
    """Return the rigs to record with: this worker's own or, where it names none, all that the service knows.

    A worker that does nothing else waits for the first one; any other begins without, and anew once there are some.
    """
    meanwhile = [kind for kind in kinds if kind != "captures"]
    waits = False
    while not (rigs := list(settings.own_rigs) or [rig.id for rig in store.known_rigs.all()]):
        if not waits:
            said = f"; it serves {', '.join(meanwhile)} meanwhile" if meanwhile else ""
            logging.getLogger(__name__).warning("the worker waits for the service to name its rigs%s", said)
        waits = True
        if meanwhile or stop.wait(_POLL_S):
            break
    return rigs


def _refresh(store: Store, rigs: Sequence[str]) -> None:
    """Mend the files of calibrations that a process chose and died before it wrote them."""
    for rig_id in rigs:
        try:
            store.rig_files.refresh(rig_id)
        except (DiskError, OSError):  # other work may need no disk, and a capture tries again
            logging.getLogger(__name__).exception("the calibration of %s is not up to date", rig_id)


def _work(store: Store, heir: Heir, parts: Parts, me: Worker, stop: threading.Event, rigs: list[str] | None) -> None:
    """Beat until told to stop or, with nothing in hand, until the service has other `rigs`; raises WorkerRunningError.

    Outages of the database are waited for.
    """
    while True:
        try:
            store.workers.beat(me)
            heir.look()
            parts.look()
            if rigs is not None and not heir.busy and [rig.id for rig in store.known_rigs.all()] != rigs:
                return
        except SQLAlchemyError as error:
            heir.pause(reason_of(error))
        if stop.wait(store.workers.beat_s):
            return


def _launch(settings: ServiceSettings, stages: Stages, parts: Parts, name: str, queues: Sequence[str]) -> None:
    refuse_pickles()
    config: DBOSConfig = {
        "name": APPLICATION,
        "system_database_url": settings.engine_url,
        "application_version": APPLICATION_VERSION,
        "executor_id": name,  # pending work belongs to it: the successor of a killed worker carries the same name
        "serializer": DBOSPortableJSONSerializer(),
        "log_level": "WARNING",
    }
    config.update(engine_tracing(settings))
    DBOS(config=config)
    configure_logs(settings)  # after the engine has set up its own
    logging.getLogger("dbos").addFilter(_one_line)

    @DBOS.workflow(name=WORKFLOW)
    async def entry(entry_id: str, names: list[str]) -> None:
        with stages.at_work(entry_id):
            for step in names:
                if step == PARTS:
                    await DBOS.run_step_async({"name": step}, parts.begin, entry_id)
                    if await parts.parked(entry_id):
                        raise engine_errors.DBOSWorkflowConflictIDError(entry_id)  # it goes on when it is woken
                    continue
                if step == STAGE:
                    await parts.expect_learnt(entry_id)
                await DBOS.run_step_async({"name": step, "preemptible": True}, _run, stages, entry_id, step)

    @DBOS.workflow(name=PART)
    async def part(entry_id: str, attempt: int, name: str) -> None:
        with stages.at_work(part_id(entry_id, attempt, name)):
            await _learn(parts, entry_id, attempt, name)

    DBOS.listen_queues(queues)
    DBOS.launch()
    for queue in queues:
        DBOS.register_queue(queue, worker_concurrency=1, polling_interval_sec=_POLL_S)


async def _run(stages: Stages, entry_id: str, stage: str) -> None:
    """Run a stage; where it was stopped with nothing made, its entry has not failed but is cancelled."""
    try:
        await stages.run(entry_id, stage)
    except StoppedStageError as stopped:
        await DBOS.cancel_workflow_async(entry_id)
        raise engine_errors.DBOSWorkflowCancelledError(str(stopped)) from stopped


async def _learn(parts: Parts, entry_id: str, attempt: int, name: str) -> None:
    """Learn a part, at most TRIES times; raises PartFailedError after the last one."""
    failed, tries = None, 0
    while tries < TRIES:
        tries += 1
        step: StepOptions = {"name": f"try {tries}", "preemptible": True}
        failed = await DBOS.run_step_async(step, _try, parts, entry_id, attempt, name)
        if failed is None or failed["bad_input"] or failed["room"]:
            break
    await DBOS.run_step_async({"name": "end"}, parts.end, entry_id, name, failed, tries)
    if failed is not None:
        raise PartFailedError(failed["reason"])


async def _try(parts: Parts, entry_id: str, attempt: int, name: str) -> dict[str, Any] | None:
    """Learn a part; where its job has ended meanwhile, it is cancelled as that is."""
    if await parts.is_wanted(entry_id, attempt):
        return await parts.learn(entry_id, name)
    await DBOS.cancel_workflow_async(part_id(entry_id, attempt, name))
    raise engine_errors.DBOSWorkflowCancelledError(f"{entry_id} has ended")


def _one_line(record: logging.LogRecord) -> bool:
    """Keep tracebacks of expected endings out of the engine's log: a failure is one line, a cancelled job none."""
    error = record.exc_info[1] if record.exc_info else None
    if isinstance(error, Spike4dgsError):
        record.msg, record.args, record.exc_info = str(error), None, None
    elif isinstance(error, SQLAlchemyError):
        record.msg, record.args, record.exc_info = reason_of(error), None, None
    elif isinstance(error, PortableWorkflowError):  # of a job that was told while it waited for its parts
        return False
    if _ELSEWHERE in record.getMessage():
        return False
    return not isinstance(error, engine_errors.DBOSAwaitedWorkflowCancelledError)


@contextmanager
def _exclusive(settings: ServiceSettings, name: str) -> Iterator[None]:
    """Hold the flock of the worker's name on this data folder: a killed worker's is free at once."""
    folder: Path = settings.data / "workers" / name
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(folder))
        except BlockingIOError as error:
            raise WorkerRunningError(
                f"found another worker {name} on {settings.data}", "none", "stop it or choose another --name"
            ) from error
        yield
