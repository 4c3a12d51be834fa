"""The worker process: alive as long as it beats, at work on its queues, heir of workers that died."""

from __future__ import annotations

import fcntl
import logging
import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from dbos import DBOS, DBOSConfig, DBOSPortableJSONSerializer
from dbos import error as engine_errors

from rigs.errors import Spike4dgsError
from server.engine import (
    APPLICATION,
    APPLICATION_VERSION,
    RECONSTRUCTIONS,
    TASKS,
    WORKFLOW,
    Engine,
    capture_queue,
)
from server.errors import WorkerRunningError
from server.pickles import refuse_pickles
from server.settings import ServiceSettings
from server.store.store import Store
from server.store.workers import BEAT_S, Worker
from server.work.stages import Stages

_POLL_S = 0.5


def run_worker(settings: ServiceSettings, name: str, kinds: Sequence[str], stop: threading.Event) -> None:
    """Work on `kinds` of queues (captures, reconstructions, tasks) until `stop` is set.

    Stages then running are stopped, and taken up again by the next worker of this `name` or, where others are alive,
    by one of them. Raises WorkerRunningError where another worker has the name.
    """
    with _exclusive(settings, name):
        store = Store.open(settings)
        queues = _queues(settings, kinds)
        me = store.workers.enter(name, queues)
        try:
            _launch(settings, store, name, queues)
            _work(settings, store, me, stop)
        finally:
            logging.getLogger("dbos").setLevel(logging.ERROR)  # it warns of every stage that is stopped here
            DBOS.destroy()
            store.workers.leave(me)
            store.close()


def _work(settings: ServiceSettings, store: Store, me: Worker, stop: threading.Event) -> None:
    engine = Engine(settings)
    try:
        while True:
            store.workers.beat(me)
            _adopt(store, engine, me)
            if stop.wait(BEAT_S):
                return
    finally:
        engine.close()


def _adopt(store: Store, engine: Engine, me: Worker) -> None:
    """Queue again what dead workers had begun; the first of the living does it for all."""
    alive = [worker.id for worker in store.workers.alive()]
    if not alive or alive[0] != me.id:
        return
    for entry in store.entries.find(engine.orphans(alive)):
        engine.adopt(entry)


def _queues(settings: ServiceSettings, kinds: Sequence[str]) -> list[str]:
    captures = [capture_queue(rig_id) for rig_id in settings.rigs] if "captures" in kinds else []
    return [*captures, *(name for name in (RECONSTRUCTIONS, TASKS) if name in kinds)]


def _launch(settings: ServiceSettings, store: Store, name: str, queues: Sequence[str]) -> None:
    refuse_pickles()
    config: DBOSConfig = {
        "name": APPLICATION,
        "system_database_url": settings.engine_url,
        "application_version": APPLICATION_VERSION,
        "executor_id": name,  # pending work belongs to it: the successor of a killed worker carries the same name
        "serializer": DBOSPortableJSONSerializer(),
        "log_level": "WARNING",
    }
    DBOS(config=config)
    logging.getLogger("dbos").addFilter(_one_line)
    stages = Stages(settings, store)

    @DBOS.workflow(name=WORKFLOW)
    async def entry(entry_id: str, names: list[str]) -> None:
        for stage in names:
            await DBOS.run_step_async({"name": stage, "preemptible": True}, stages.run, entry_id, stage)

    DBOS.listen_queues(queues)
    DBOS.launch()
    for queue in queues:
        DBOS.register_queue(queue, worker_concurrency=1, polling_interval_sec=_POLL_S)


def _one_line(record: logging.LogRecord) -> bool:
    """Keep tracebacks of expected endings out of the engine's log: a failure is one line, a cancelled job none."""
    error = record.exc_info[1] if record.exc_info else None
    if isinstance(error, Spike4dgsError):
        record.msg, record.args, record.exc_info = str(error), None, None
    return not isinstance(error, engine_errors.DBOSAwaitedWorkflowCancelledError)


@contextmanager
def _exclusive(settings: ServiceSettings, name: str) -> Iterator[None]:
    """Hold the flock of the worker's name on this data folder: a killed worker's is free at once."""
    folder: Path = settings.data / "workers" / name
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise WorkerRunningError(
                f"found another worker {name} on {settings.data}, expected none; stop it or choose another --name"
            ) from error
        yield
    finally:
        os.close(descriptor)
