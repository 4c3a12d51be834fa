"""Runs each stage of an entry: puts its inputs in place, starts its process, and keeps its results."""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from pathlib import Path

from sqlalchemy.exc import SQLAlchemyError

from acquisition.durable import write_durably
from acquisition.recording.reader import Recording
from reconstruction.run.configuration import FOLLOW
from reconstruction.run.parts import PartFolder
from rigs.errors import Spike4dgsError
from server.contact_sheet import camera_picture, contact_sheet, figures
from server.errors import NotFoundError
from server.settings import ServiceSettings
from server.store import database
from server.store.artefacts import MOST, is_plain, plain_files
from server.store.looks import keep_look
from server.store.store import Store
from server.store.tables import Entry
from server.work.calibrations import keep_calibration, write_current
from server.work.commands import (
    import_arguments,
    look_arguments,
    preflight_arguments,
    reconstruct_arguments,
    task_arguments,
)
from server.work.moments import Moments
from server.work.part_reporter import PARTS_SHARE, STAGE
from server.work.processes import Processes, as_told, is_finished, is_full, no_room
from server.work.reporter import Reporter
from server.work.supervisor import BadInputError, StageError

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
_OUTAGE_POLL_S = 1.0
_LOOKS_POLL_S = 2.0  # seconds between questions for a scene that a job shows before it has ended


class Stages:
    """Runs the stages of captures and jobs of one service."""

    def __init__(self, settings: ServiceSettings, store: Store) -> None:
        self._settings = settings
        self._store = store
        self._folder = store.folder
        self.processes = Processes(settings, store)
        self._moments = Moments(store, self.processes)
        self._by_type = {
            "record": self._record,
            "import": self._import,
            "preflight": self._preflight,
            "look": self._look,
            "reconstruct": self._reconstruct,
        }
        self.busy: Counter[str] = Counter()

    @contextmanager
    def at_work(self, name: str) -> Iterator[None]:
        """Note that an entry or part is in this worker's hands, in which it may be again before it has left them."""
        self.busy.update([name])
        try:
            yield
        finally:
            self.busy -= Counter([name])

    async def run(self, entry_id: str, stage: str) -> None:
        """Run one stage: from its own checkpoint on if it was interrupted, not again if it is finished.

        A database that does not answer is waited for. Raises StageError, and DiskError where there is no room left.
        """
        while True:
            try:
                (entry,) = self._store.entries.find([entry_id])
                if entry.kind == "capture" and self._folder.recording(entry_id).exists():
                    return self._moments.tell_losses(entry, stage)  # made by a worker that was killed
                return await self._by_type.get(entry.type, self._task)(entry, stage)
            except NotFoundError as error:
                Reporter(self._store, entry_id, stage).close(error)
                raise
            except SQLAlchemyError as error:
                if database.is_full(error):
                    raise no_room(self._settings.database_name) from error
                if not database.is_outage(error):
                    raise
            except OSError as error:
                if not is_full(error):
                    raise
                raise no_room(self._folder.path) from error
            await asyncio.sleep(_OUTAGE_POLL_S)

    async def _record(self, entry: Entry, stage: str) -> None:
        await self._moments.record(entry, stage, *self._rig(entry))

    async def _import(self, entry: Entry, stage: str) -> None:
        recording = self._folder.recording(entry.id)
        dats = [self._folder.upload(upload_id) / "data" for upload_id in entry.request["dats"]]
        cameras = self._folder.entry(entry.id) / entry.request["cameras"]
        arguments = import_arguments(entry.request, dats, cameras, recording, self._store.disk.keep_free)
        await self._moments.run_import(entry, stage, arguments)

    async def _preflight(self, entry: Entry, stage: str) -> None:
        rig, devices, lock = self._rig(entry)
        out = self._fresh_out(entry)
        arguments = preflight_arguments(entry.request, rig, devices, self._folder.path / "captures")
        with _telling(self._store, entry, stage):
            await self.processes.run(entry, stage, arguments, locks=[lock], stdout=out / "result.json", repeats=True)
            _hide_paths(self._store, out)
        self._store.artefacts.catalogue(entry.id, out, plain_files(out))

    async def _look(self, entry: Entry, stage: str) -> None:
        rig, devices, lock = self._rig(entry)
        out = self._fresh_out(entry)
        recording = self._folder.job(entry.id) / "recording"
        self._folder.remove(recording)
        try:
            with _telling(self._store, entry, stage):
                try:
                    arguments = look_arguments(entry.request, rig, devices, recording)
                    await self.processes.run(entry, stage, arguments, locks=[lock], repeats=True)
                except StageError:
                    if not recording.exists():  # else a camera failed, and the others are worth seeing
                        raise
                await asyncio.to_thread(_keep_look, Recording.open(recording), out, lock)
        finally:
            self._folder.remove(recording)
        self._store.artefacts.catalogue(entry.id, out, plain_files(out))

    async def _reconstruct(self, entry: Entry, stage: str) -> None:
        run = self._folder.run(entry.id)
        arguments = reconstruct_arguments(entry.request, stage, self._recording(entry), run, entry.restart)
        begins = PARTS_SHARE if stage == STAGE and PartFolder(run).noted() else 0.0
        is_due = lambda: not is_finished(run, stage, entry)  # noqa: E731
        catalogue = lambda: self._store.artefacts.catalogue(entry.id, run, _run_artefacts(run))  # noqa: E731
        async with _catalogued(catalogue, meanwhile=stage == FOLLOW):
            await self.processes.run(entry, stage, arguments, is_due=is_due, begins=begins)

    async def _task(self, entry: Entry, stage: str) -> None:
        is_finished = self.processes.finished(entry, stage).exists()
        out = self._folder.out(entry.id) if is_finished else self._fresh_out(entry)
        with _telling(self._store, entry, stage):
            arguments = self._arguments(entry, out)
            printed = out / "result.json" if "--json" in arguments else None
            await self.processes.run(entry, stage, arguments, stdout=printed)
            _hide_paths(self._store, out)
            if entry.type == "calibrate":
                keep_calibration(self._store, entry, out)
        files = self._store.artefacts.catalogue(entry.id, out, plain_files(out))
        if files > MOST:
            _warn_of_many(self._store, entry, stage, files)

    def _arguments(self, entry: Entry, out: Path) -> list[str]:
        folder, request = self._folder, entry.request
        recording = self._recording(entry)
        if not recording.is_dir():  # the job waited for it, or it was deleted meanwhile
            kept = self._store.entries.find([entry.capture or ""])
            kind = StageError if kept else BadInputError  # what is kept may yet be finalised
            raise kind(f"found no recording of {entry.capture}", "it made and kept", "look at that capture")
        run = folder.run(request["job"]) if "job" in request else None
        dark = folder.recording(request["dark"]) if request.get("dark") else None
        of_rig = entry.type == "check-rig" and request.get("rig")
        rig = write_current(self._store, of_rig, out) if of_rig else None
        cameras = folder.upload(request["cameras"]) / "data" if entry.type == "render" else None
        return task_arguments(request, recording, run, out, dark=dark, rig=rig, cameras=cameras)

    def _recording(self, entry: Entry) -> Path:
        assert entry.capture is not None
        return self._folder.recording(entry.capture)

    def _rig(self, entry: Entry) -> tuple[str, str, Path]:
        """Return the rig's file, its devices, and the folder whose flock keeps others from its cameras."""
        assert entry.rig is not None
        drawn, calibrated = (path(entry.rig) for path in (self._store.rig_files.drawn, self._store.rig_files.refresh))
        mine = self._settings.own_rigs.get(entry.rig)
        devices = mine.devices if mine else self._store.known_rigs.get(entry.rig).devices
        return str(calibrated if calibrated.exists() else drawn), devices, self._folder.rig(entry.rig)

    def _fresh_out(self, entry: Entry) -> Path:
        """Return an empty folder for what a job makes, whatever an attempt that was interrupted left."""
        out = self._folder.out(entry.id)
        self._folder.remove(out)
        out.mkdir(parents=True)
        return out


def _hide_paths(store: Store, out: Path) -> None:
    """Say what a command printed without the place of the data folder: others read it."""
    printed = out / "result.json"
    if printed.exists():
        write_durably(printed, store.folder.hidden(printed.read_text()).encode())


@contextmanager
def _telling(store: Store, entry: Entry, stage: str) -> Iterator[None]:
    """Tell of an entry what fails in the block, which does more than run a process."""
    try:
        yield
    except (Spike4dgsError, OSError) as error:
        Reporter(store, entry.id, stage).close(as_told(error, store.folder.path))
        raise


def _warn_of_many(store: Store, entry: Entry, stage: str, files: int) -> None:
    reporter = Reporter(store, entry.id, stage)
    folder = f"jobs/{entry.id}/out of the data folder"
    reporter.warn(f"{MOST} of {files} files are listed and can be fetched; all of them lie in {folder}")
    reporter.close()


@asynccontextmanager
async def _catalogued(catalogue: Callable[[], object], *, meanwhile: bool) -> AsyncIterator[None]:
    """Note in the end what a stage has made, and `meanwhile` every few seconds, also where one time fails."""
    over = asyncio.Event()

    async def look() -> None:
        while not over.is_set():
            try:
                await asyncio.wait_for(over.wait(), _LOOKS_POLL_S)
            except TimeoutError:
                with suppress(SQLAlchemyError, OSError):
                    await asyncio.to_thread(catalogue)

    looking = asyncio.create_task(look()) if meanwhile else None
    try:
        yield
    finally:
        over.set()
        if looking is not None:
            await looking
        catalogue()


def _keep_look(recording: Recording, out: Path, rig: Path) -> None:
    """Keep what the cameras saw in the folder of a rig, and the picture of all of them in that of the job, too."""
    pictures = {camera_id: camera_picture(recording, camera_id) for camera_id in recording.camera_ids}
    keep_look(rig, figures(recording), pictures)
    png = contact_sheet(recording)
    for folder in (out, rig):  # last, because its tag tells that there is a new look
        write_durably(folder / "look.png", png)


def _run_artefacts(run: Path) -> Iterator[str]:
    """Yield the names of the files of a run folder that may be handed out: not its checkpoints."""
    yield from (name for name in RUN_ARTEFACTS if is_plain(run, name))
    yield from (f"thumbnails/{name}" for name in plain_files(run / "thumbnails"))
