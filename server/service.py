"""What the web process does: keep the catalogue, and ask the job engine. It runs nothing itself."""

from __future__ import annotations

import json
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path

from dbos import DBOSClient, DBOSPortableJSONSerializer, EnqueueOptions

from rigs.toml import load_rig
from server.catalogue import Catalogue, Entry
from server.database import prepare_database
from server.errors import NotFoundError, RigBusyError, StateError, UnknownReferenceError
from server.jobs import (
    APPLICATION,
    APPLICATION_VERSION,
    ARTEFACTS,
    CAPTURE,
    CAPTURE_QUEUE,
    RECONSTRUCT,
    RECONSTRUCT_QUEUE,
)
from server.schemas import Artefact, CameraInfo, Capture, CaptureRequest, Check, Job, JobRequest, RigInfo, Status
from server.settings import ServiceSettings
from server.supervisor import is_locked

_STATUS: dict[str, Status] = {
    "ENQUEUED": "queued",
    "DELAYED": "queued",
    "PENDING": "running",
    "SUCCESS": "done",
    "CANCELLED": "cancelled",
}
_ACTIVE = ("queued", "running")
_STALE_S = 10.0
_FREE_BYTES = 2**30


class Service:
    """The rigs, captures and jobs of one data folder. Raises RigError for a rig that cannot be loaded."""

    def __init__(self, settings: ServiceSettings, clock: Callable[[], float] = time.time) -> None:
        self.settings = settings
        self.rigs = {rig_id: source.load() for rig_id, source in settings.rigs.items()}
        self.catalogue = Catalogue(settings.data)
        self._clock = clock
        self._one_at_a_time = threading.Lock()
        prepare_database(settings)
        self._engine = DBOSClient(
            system_database_url=settings.database_url,
            serializer=DBOSPortableJSONSerializer(),
            application_name=APPLICATION,
        )

    def close(self) -> None:
        """Let go of the database."""
        self._engine.destroy()

    # Rigs and captures

    def rig(self, rig_id: str) -> RigInfo:
        """One rig; raises NotFoundError."""
        if rig_id not in self.rigs:
            raise NotFoundError(f"found no rig {rig_id[:60]}, expected one of {', '.join(self.rigs)}")
        rig = self.rigs[rig_id]
        return RigInfo(
            id=rig_id,
            name=rig.name,
            tick_rate_hz=rig.tick_rate_hz,
            poses=rig.poses,
            devices=self.settings.rigs[rig_id].devices,
            cameras=[CameraInfo(id=camera.id, width=camera.width, height=camera.height) for camera in rig.cameras],
            busy=next((c.id for c in self.captures() if c.rig == rig_id and c.status in _ACTIVE), None),
        )

    def start_capture(self, rig_id: str, request: CaptureRequest) -> Capture:
        """Queue a recording; raises NotFoundError and, while the rig is busy, RigBusyError."""
        with self._one_at_a_time:
            busy = self.rig(rig_id).busy
            if busy is not None:
                raise RigBusyError(f"found rig {rig_id} busy with {busy}, expected it idle; wait for that capture")
            entry = self.catalogue.add("capture", {"rig": rig_id, **request.model_dump()})
            self._enqueue(entry, CAPTURE, CAPTURE_QUEUE, partition=rig_id)
        return self.capture(entry.id)

    def capture(self, capture_id: str) -> Capture:
        """One capture; raises NotFoundError."""
        return self._captures([self.catalogue.entry("capture", capture_id)])[0]

    def captures(self) -> list[Capture]:
        """All captures, newest first."""
        return self._captures(self.catalogue.entries("capture"))

    def _captures(self, entries: list[Entry]) -> list[Capture]:
        status = self._status(entries)
        return [
            Capture(
                id=entry.id,
                created=entry.created,
                status=status[entry.id],
                **entry.request,
                **self.catalogue.progress(entry.id).model_dump(),
            )
            for entry in entries
        ]

    # Jobs

    def submit(self, request: JobRequest) -> Job:
        """Queue a reconstruction.

        Raises UnknownReferenceError, StateError before the capture is done, and RigError for a holdout it lacks.
        """
        try:
            capture = self.capture(request.capture)
        except NotFoundError as error:
            raise UnknownReferenceError(str(error)) from error
        if capture.status != "done":
            raise StateError(f"found capture {capture.id} {capture.status}, expected it done; wait for it")
        if request.holdout is not None:
            load_rig(self.catalogue.recording(capture.id) / "rig.toml").camera(request.holdout)
        entry = self.catalogue.add("job", request.model_dump())
        self.catalogue.run(entry.id).parent.mkdir()
        self._enqueue(entry, RECONSTRUCT, RECONSTRUCT_QUEUE)
        return self.job(entry.id)

    def job(self, job_id: str) -> Job:
        """One job; raises NotFoundError."""
        return self._jobs([self.catalogue.entry("job", job_id)])[0]

    def jobs(self) -> list[Job]:
        """All jobs, newest first."""
        return self._jobs(self.catalogue.entries("job"))

    def _jobs(self, entries: list[Entry]) -> list[Job]:
        status = self._status(entries)
        return [
            Job(
                id=entry.id,
                created=entry.created,
                status=status[entry.id],
                request=JobRequest(**entry.request),
                **self.catalogue.progress(entry.id).model_dump(),
            )
            for entry in entries
        ]

    def cancel(self, job_id: str) -> Job:
        """Stop a job that is queued or running; raises NotFoundError, StateError."""
        self._expect(self.job(job_id), *_ACTIVE)
        self._engine.cancel_workflow(job_id)
        return self.job(job_id)

    def resume(self, job_id: str) -> Job:
        """Queue a failed or cancelled job again from the stage it stopped in; raises NotFoundError, StateError."""
        self._expect(self.job(job_id), "failed", "cancelled")
        if is_locked(self.catalogue.folder(job_id)):
            raise StateError(f"found {job_id} still stopping, expected it stopped; try again in a few seconds")
        steps = self._engine.list_workflow_steps(job_id)
        unfinished = next((step["function_id"] for step in steps if step["error"]), len(steps) + 1)
        self._engine.rewind_workflow(
            job_id, start_step=unfinished, application_version=APPLICATION_VERSION, queue_name=RECONSTRUCT_QUEUE
        )
        return self.job(job_id)

    @staticmethod
    def _expect(job: Job, *states: Status) -> None:
        if job.status not in states:
            raise StateError(f"found {job.id} {job.status}, expected it {' or '.join(states)}")

    # What jobs leave

    def log(self, job_id: str) -> str:
        """What the job's stages wrote; raises NotFoundError."""
        path = self.catalogue.log(self.catalogue.entry("job", job_id).id)
        return path.read_text(errors="replace") if path.exists() else ""

    def artefacts(self, job_id: str) -> list[Artefact]:
        """What the job has made so far; raises NotFoundError."""
        run = self.catalogue.run(self.catalogue.entry("job", job_id).id)
        return [
            Artefact(name=name, media_type=media_type, bytes=(run / name).stat().st_size)
            for name, media_type in ARTEFACTS.items()
            if _plain(run / name)
        ]

    def artefact(self, job_id: str, name: str) -> tuple[Path, str]:
        """Path and media type of an artefact named in the catalogue; raises NotFoundError."""
        path = self.catalogue.run(self.catalogue.entry("job", job_id).id) / name
        if name not in ARTEFACTS or not _plain(path):
            raise NotFoundError(f"found no artefact {name[:60]}, expected one of {', '.join(ARTEFACTS)}")
        return path, ARTEFACTS[name]

    # Health and the engine

    def checks(self) -> dict[str, Check]:
        """The conditions of being ready: database, disk, worker."""
        self._engine.check_connection()
        free = shutil.disk_usage(self.settings.data).free
        beat = self.settings.data / "worker.json"
        try:
            age_s = self._clock() - json.loads(beat.read_text())["beat_s"]
            worker = Check(ok=age_s < _STALE_S, found=f"heartbeat {age_s:.0f} s old")
        except FileNotFoundError:
            worker = Check(ok=False, found="no worker; run spike4dgs worker on this data folder")
        return {
            "database": Check(ok=True, found="answers"),
            "disk": Check(ok=free >= _FREE_BYTES, found=f"{free / 2**30:.1f} GiB free"),
            "worker": worker,
        }

    def _status(self, entries: list[Entry]) -> dict[str, Status]:
        ids = [entry.id for entry in entries]
        found = self._engine.list_workflows(workflow_ids=ids, load_input=False, load_output=False) if ids else []
        known: dict[str, Status] = {workflow.workflow_id: _STATUS.get(workflow.status, "failed") for workflow in found}
        return {entry_id: known.get(entry_id, "failed") for entry_id in ids}

    def _enqueue(self, entry: Entry, workflow: str, queue: str, partition: str | None = None) -> None:
        options: EnqueueOptions = {
            "workflow_name": workflow,
            "queue_name": queue,
            "workflow_id": entry.id,
            "app_version": APPLICATION_VERSION,
        }
        if partition is not None:
            options["queue_partition_key"] = partition
        try:
            self._engine.enqueue(options, entry.id)
        except BaseException:
            self.catalogue.remove(entry.id)
            raise


def _plain(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()
