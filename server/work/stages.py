"""What each stage of an entry runs, and where its results go."""

from __future__ import annotations

import asyncio
import errno
import json
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy.exc import SQLAlchemyError

from acquisition.durable import write_durably
from acquisition.errors import DiskError
from acquisition.recording.reader import Recording, read_manifest
from rigs.errors import Spike4dgsError
from server.contact_sheet import contact_sheet
from server.settings import ServiceSettings
from server.store.artefacts import is_plain, plain_files
from server.store.database import is_full, is_outage
from server.store.store import Store
from server.store.tables import Entry
from server.work.calibrations import keep_calibration, write_current
from server.work.commands import (
    import_arguments,
    look_arguments,
    preflight_arguments,
    reconstruct_arguments,
    record_arguments,
    rig_argument,
    task_arguments,
)
from server.work.reporter import Reporter
from server.work.supervisor import Control, StageError, supervise

RUN_ARTEFACTS = (
    "run.json",
    "metrics.json",
    "error_vs_time.json",
    "error_vs_time.png",
    "report.html",
    "orbit.mp4",
    "viewer.json",
    "viewer.bin",
    "poses/rig.toml",
    "poses/refined.toml",
)
_NO_ROOM = "found no space left, expected some; free some and resume the job"
_OUTAGE_POLL_S = 1.0
ANSWERS = ("check-rig", "verify", "preflight")  # whose exit code 1 is an answer, not a failure


def run_artefacts(run: Path) -> Iterator[str]:
    """Names of what may be handed out of a run folder: not its checkpoints."""
    yield from (name for name in RUN_ARTEFACTS if is_plain(run, name))
    yield from (f"thumbnails/{name}" for name in plain_files(run / "thumbnails"))


class Stages:
    """Runs the stages of captures and jobs of one service."""

    def __init__(self, settings: ServiceSettings, store: Store) -> None:
        self._settings = settings
        self._store = store
        self._folder = store.folder
        self.busy: set[str] = set()

    @contextmanager
    def at_work(self, entry_id: str) -> Iterator[None]:
        """Note that an entry is in this worker's hands."""
        self.busy.add(entry_id)
        try:
            yield
        finally:
            self.busy.discard(entry_id)

    async def run(self, entry_id: str, stage: str) -> None:
        """Run one stage: one that was interrupted from its own checkpoint on, one that is finished not again.

        A database that does not answer is waited for. Raises StageError, and DiskError where there is no room left.
        """
        while True:
            try:
                (entry,) = self._store.entries.find([entry_id])
                return await self._work(entry.type)(entry, stage)
            except SQLAlchemyError as error:
                if is_full(error):
                    raise DiskError(f"{self._settings.database_name}: {_NO_ROOM}") from error
                if not is_outage(error):
                    raise
            except OSError as error:
                if not _is_full(error):
                    raise
                raise DiskError(f"{self._folder.path}: {_NO_ROOM}") from error
            await asyncio.sleep(_OUTAGE_POLL_S)

    def _work(self, entry_type: str) -> Callable[[Entry, str], Awaitable[None]]:
        kinds = {
            "record": self._record,
            "import": self._import,
            "preflight": self._preflight,
            "look": self._look,
            "reconstruct": self._reconstruct,
        }
        return kinds.get(entry_type, self._task)

    async def _record(self, entry: Entry, stage: str) -> None:
        recording = self._folder.recording(entry.id)
        if recording.exists():  # made by a worker that was killed: it has this name only when it is whole
            return
        rig, devices, lock = self._rig(entry)
        arguments = record_arguments(entry.request, rig, devices, recording)
        control = Control(self._folder.entry(entry.id) / "stop", self._folder.entry(entry.id) / "save")
        try:
            await self._supervise(entry, stage, arguments, [lock], control=control)
        except StageError:
            if not recording.exists():  # else it was kept, and says itself what it lacks
                raise
            reporter = Reporter(self._store, entry.id, stage)
            reporter(1.0, f"kept, incomplete: {read_manifest(recording).reason}")
            reporter.close()

    async def _import(self, entry: Entry, stage: str) -> None:
        recording = self._folder.recording(entry.id)
        if recording.exists():  # made by a worker that was killed: it has this name only when it is whole
            return
        dats = [self._folder.upload(upload_id) / "data" for upload_id in entry.request["dats"]]
        cameras = self._folder.entry(entry.id) / entry.request["cameras"]
        await self._supervise(entry, stage, import_arguments(entry.request, dats, cameras, recording), [])

    async def _preflight(self, entry: Entry, stage: str) -> None:
        rig, devices, lock = self._rig(entry)
        out = self._fresh_out(entry)
        arguments = preflight_arguments(entry.request, rig, devices, self._folder.path / "captures")
        await self._supervise(entry, stage, arguments, [lock], stdout=out / "result.json", repeats=True)
        self._store.artefacts.catalogue(entry.id, out, plain_files(out))

    async def _look(self, entry: Entry, stage: str) -> None:
        rig, devices, lock = self._rig(entry)
        out = self._fresh_out(entry)
        recording = self._folder.job(entry.id) / "recording"
        self._folder.remove(recording)
        try:
            try:
                arguments = look_arguments(entry.request, rig, devices, recording)
                await self._supervise(entry, stage, arguments, [lock], repeats=True)
            except StageError:
                if not recording.exists():  # else a camera failed, and the others are worth seeing
                    raise
            png = await asyncio.to_thread(lambda: contact_sheet(Recording.open(recording)))
            for folder in (out, lock):
                write_durably(folder / "look.png", png)
        finally:
            self._folder.remove(recording)
        self._store.artefacts.catalogue(entry.id, out, plain_files(out))

    def _rig(self, entry: Entry) -> tuple[str, str, Path]:
        """The rig's file or name, its devices, and the folder whose flock keeps others from its cameras."""
        source = self._settings.rigs.get(entry.rig or "")
        if source is None or entry.rig is None:
            raise StageError(f"found no rig {entry.rig} in this worker's settings", "the service's own rigs")
        calibrated = self._store.rig_files.refresh(entry.rig)
        return rig_argument(source, calibrated), source.devices, self._folder.rig(entry.rig)

    def _fresh_out(self, entry: Entry) -> Path:
        """An empty folder for what a job makes, whatever an attempt that was interrupted left."""
        out = self._folder.out(entry.id)
        self._folder.remove(out)
        out.mkdir(parents=True)
        return out

    async def _reconstruct(self, entry: Entry, stage: str) -> None:
        run = self._folder.run(entry.id)
        assert entry.capture is not None
        recording = self._folder.recording(entry.capture)
        arguments = reconstruct_arguments(entry.request, stage, recording, run, entry.restart)
        try:
            await self._supervise(
                entry, stage, arguments, [], trains=True, is_due=lambda: not _finished(run, stage, entry.restart)
            )
        finally:
            self._store.artefacts.catalogue(entry.id, run, run_artefacts(run))

    async def _task(self, entry: Entry, stage: str) -> None:
        out = self._folder.out(entry.id) if self._finished(entry, stage).exists() else self._fresh_out(entry)
        assert entry.capture is not None
        try:
            arguments = self._arguments(entry, entry.capture, out)
            printed = out / "result.json" if "--json" in arguments else None
            await self._supervise(entry, stage, arguments, [], stdout=printed)
            if entry.type == "calibrate":
                keep_calibration(self._store, self._settings, entry, out)
        except (Spike4dgsError, OSError) as error:
            Reporter(self._store, entry.id, stage).close(str(error))
            raise
        self._store.artefacts.catalogue(entry.id, out, plain_files(out))

    def _arguments(self, entry: Entry, capture: str, out: Path) -> list[str]:
        folder, request = self._folder, entry.request
        recording = folder.recording(capture)
        if not recording.is_dir():  # the job waited for it, or it was deleted meanwhile
            raise StageError(f"found no recording of {capture}", "it made and kept", "look at that capture")
        run = folder.run(request["job"]) if "job" in request else None
        dark = folder.recording(request["dark"]) if request.get("dark") else None
        of_rig = entry.type == "check-rig" and request.get("rig")
        rig = write_current(self._store, self._settings, of_rig, out) if of_rig else None
        cameras = folder.upload(request["cameras"]) / "data" if entry.type == "render" else None
        return task_arguments(request, recording, run, out, dark=dark, rig=rig, cameras=cameras)

    async def _supervise(
        self,
        entry: Entry,
        stage: str,
        arguments: list[str],
        locks: list[Path],
        *,
        control: Control | None = None,
        stdout: Path | None = None,
        trains: bool = False,
        repeats: bool = False,
        is_due: Callable[[], bool] = lambda: True,
    ) -> None:
        """Run the stage's process; one that `repeats` leaves no mark, since its results do not outlive its worker."""
        reporter = Reporter(self._store, entry.id, stage)
        try:
            await supervise(
                [*self._settings.stage_command, *arguments],
                folders=[self._folder.entry(entry.id), *locks, *(self._accelerator() if trains else ())],
                log=self._folder.log(entry.id),
                finished=None if repeats else self._finished(entry, stage),
                is_due=is_due,
                on_progress=reporter,
                grace_s=self._settings.grace_s,
                control=control,
                stdout=stdout,
                answers=entry.type in ANSWERS,
                environment={} if self._settings.gpu is None else {"CUDA_VISIBLE_DEVICES": str(self._settings.gpu)},
            )
        except Spike4dgsError as error:
            reporter.close(str(error))
            raise
        except OSError as error:
            reporter.close(f"{self._folder.path}: {_NO_ROOM}" if _is_full(error) else str(error))
            raise
        reporter.close()

    def _finished(self, entry: Entry, stage: str) -> Path:
        """The mark of a finished stage; a restart, which counts attempts, begins without."""
        attempt = 0 if entry.restart is None else entry.restart["attempt"]
        return self._folder.entry(entry.id) / f"{stage}.{attempt}.finished"

    def _accelerator(self) -> Iterator[Path]:
        """The folder whose flock says that the accelerator is taken; on this host, not on shared storage."""
        if self._settings.gpu is not None:
            folder = self._settings.locks / f"gpu{self._settings.gpu}"
            folder.mkdir(parents=True, exist_ok=True)
            yield folder


def _is_full(error: OSError) -> bool:
    return error.errno in (errno.ENOSPC, errno.EDQUOT)


def _finished(run: Path, stage: str, restart: dict[str, Any] | None) -> bool:
    """Whether the run says so itself; who ran the stage may have died before it could."""
    if not (run / "run.json").exists():
        return False
    document = json.loads((run / "run.json").read_text())
    attempt = 0 if restart is None else restart["attempt"]
    return stage in document.get("seconds", {}) and document.get("attempt", 0) == attempt
