"""The worker: takes captures and jobs off the queues and runs each stage as a process."""

from __future__ import annotations

import fcntl
import json
import logging
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dbos import DBOS, DBOSConfig, DBOSPortableJSONSerializer
from dbos import error as engine_errors

from acquisition.durable import write_json
from rigs.errors import Spike4dgsError
from server.catalogue import Catalogue
from server.database import prepare_database
from server.errors import ServiceError
from server.jobs import (
    APPLICATION,
    APPLICATION_VERSION,
    CAPTURE,
    CAPTURE_QUEUE,
    CAPTURE_STAGES,
    RECONSTRUCT,
    RECONSTRUCT_QUEUE,
    RECONSTRUCTION_STAGES,
    reconstruct_arguments,
    record_arguments,
)
from server.schemas import CaptureRequest, JobRequest, Progress
from server.settings import ServiceSettings
from server.supervisor import StageError, supervise

# Pending work belongs to an executor by name: the successor of a killed worker must carry the same one.
_EXECUTOR = "worker-0"
_BEAT_S = 2.0
_WRITE_EVERY_S = 0.5


class WorkerRunningError(ServiceError):
    """Another worker has this data folder."""

    exit_code = 2


class Stages:
    """Runs the stages of captures and jobs of one data folder."""

    def __init__(self, settings: ServiceSettings) -> None:
        self._settings = settings
        self._catalogue = Catalogue(settings.data)

    async def record(self, capture_id: str, stage: str) -> None:
        """Make a capture's recording, or keep it where a killed worker had finished it."""
        request = dict(self._catalogue.entry("capture", capture_id).request)
        rig_id = request.pop("rig")
        recording = self._catalogue.recording(capture_id)
        if recording.exists():  # it appears under this name only when it is whole
            return
        if rig_id not in self._settings.rigs:
            raise StageError(f"found no rig {rig_id} in this worker's settings, expected the service's own rigs")
        arguments = record_arguments(CaptureRequest(**request), self._settings.rigs[rig_id], recording)
        await self._run(capture_id, stage, arguments, [self._catalogue.rig_lock(rig_id)])

    async def reconstruct(self, job_id: str, stage: str) -> None:
        """Run one stage of a reconstruction; a stage that was interrupted goes on from its own checkpoint."""
        request = JobRequest(**self._catalogue.entry("job", job_id).request)
        recording, run = self._catalogue.recording(request.capture), self._catalogue.run(job_id)
        if _finished(run):  # by a killed worker, which had no time to say so
            return
        arguments = reconstruct_arguments(request, stage, recording, run)
        await self._run(job_id, stage, arguments, [])

    async def _run(self, entry_id: str, stage: str, arguments: list[str], locks: list[Path]) -> None:
        reporter = _Reporter(self._catalogue, entry_id, stage)
        try:
            await supervise(
                [*self._settings.stage_command, *arguments],
                folders=[self._catalogue.folder(entry_id), *locks],
                log=self._catalogue.log(entry_id),
                on_progress=reporter,
                grace_s=self._settings.grace_s,
            )
        except (Spike4dgsError, OSError) as error:
            reporter.close(str(error))
            raise
        reporter.close()


class _Reporter:
    """Writes a stage's progress into the catalogue, at most twice a second."""

    def __init__(self, catalogue: Catalogue, entry_id: str, stage: str) -> None:
        self._catalogue = catalogue
        self._entry_id = entry_id
        self._latest = Progress(stage=stage)
        self._stage = stage
        self._earlier = catalogue.progress(entry_id).seconds
        self._began = time.monotonic()
        self._write()

    def __call__(self, fraction: float, message: str) -> None:
        """Progress of the stage."""
        self._latest = Progress(stage=self._stage, fraction=fraction, message=message)
        if time.monotonic() - self._written >= _WRITE_EVERY_S:
            self._write()

    def close(self, error: str | None = None) -> None:
        """The stage is over, done or with an error."""
        end: dict[str, object] = {"fraction": 1.0} if error is None else {"error": error}
        self._latest = self._latest.model_copy(update=end)
        self._write()

    def _write(self) -> None:
        self._written = time.monotonic()
        seconds = self._earlier.get(self._stage, 0.0) + self._written - self._began  # earlier attempts count
        by_stage = self._earlier | {self._stage: round(seconds, 2)}
        self._catalogue.write_progress(self._entry_id, self._latest.model_copy(update={"seconds": by_stage}))


def run_worker(settings: ServiceSettings, stop: threading.Event) -> None:
    """Work until `stop` is set; stages then running are stopped, and taken up again by the next worker.

    Raises WorkerRunningError where another worker has the data folder.
    """
    with _exclusive(settings.data):
        beat = settings.data / "worker.json"
        _launch(settings)
        try:
            while True:
                write_json(beat, {"pid": os.getpid(), "beat_s": time.time()})
                if stop.wait(_BEAT_S):
                    return
        finally:
            logging.getLogger("dbos").setLevel(logging.ERROR)  # it warns of every stage that is stopped here
            DBOS.destroy()
            beat.unlink(missing_ok=True)


def _launch(settings: ServiceSettings) -> None:
    config: DBOSConfig = {
        "name": APPLICATION,
        "system_database_url": settings.database_url,
        "application_version": APPLICATION_VERSION,
        "executor_id": _EXECUTOR,
        "serializer": DBOSPortableJSONSerializer(),
        "log_level": "WARNING",
    }
    prepare_database(settings)
    DBOS(config=config)
    logging.getLogger("dbos").addFilter(_one_line)
    _register(Stages(settings))
    DBOS.launch()
    DBOS.register_queue(CAPTURE_QUEUE, partition_worker_concurrency=1, polling_interval_sec=0.5)
    DBOS.register_queue(RECONSTRUCT_QUEUE, worker_concurrency=1, polling_interval_sec=0.5)


def _register(stages: Stages) -> None:
    @DBOS.workflow(name=CAPTURE)
    async def capture(capture_id: str) -> None:
        for stage in CAPTURE_STAGES:
            await DBOS.run_step_async({"name": stage, "preemptible": True}, stages.record, capture_id, stage)

    @DBOS.workflow(name=RECONSTRUCT)
    async def reconstruct(job_id: str) -> None:
        for stage in RECONSTRUCTION_STAGES:
            await DBOS.run_step_async({"name": stage, "preemptible": True}, stages.reconstruct, job_id, stage)


def _finished(run: Path) -> bool:
    document = run / "run.json"
    return document.exists() and json.loads(document.read_text()).get("status") == "finished"


def _one_line(record: logging.LogRecord) -> bool:
    """Keep tracebacks of expected endings out of the engine's log: a failure is one line, a cancelled job none."""
    error = record.exc_info[1] if record.exc_info else None
    if isinstance(error, Spike4dgsError):
        record.msg, record.args, record.exc_info = str(error), None, None
    return not isinstance(error, engine_errors.DBOSAwaitedWorkflowCancelledError)


@contextmanager
def _exclusive(folder: Path) -> Iterator[None]:
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise WorkerRunningError(f"found another worker on {folder}, expected none; stop it first") from error
        yield
    finally:
        os.close(descriptor)
