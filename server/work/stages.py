"""What each stage of an entry runs, and where its results go."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from acquisition.recording.reader import read_manifest
from rigs.errors import Spike4dgsError
from server.settings import ServiceSettings
from server.store.artefacts import is_plain, plain_files
from server.store.entries import Entry
from server.store.store import Store
from server.work.commands import reconstruct_arguments, record_arguments, rig_argument, task_arguments
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
ANSWERS = ("check-rig", "verify")  # whose exit code 1 is an answer, not a failure


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

    async def run(self, entry_id: str, stage: str) -> None:
        """Run one stage; one that was interrupted goes on from its own checkpoint."""
        (entry,) = self._store.entries.find([entry_id])
        work = {"record": self._record, "reconstruct": self._reconstruct}.get(entry.type, self._task)
        await work(entry, stage)

    async def _record(self, entry: Entry, stage: str) -> None:
        recording = self._folder.recording(entry.id)
        if recording.exists():  # made by a worker that was killed: it has this name only when it is whole
            return
        source = self._settings.rigs.get(entry.rig or "")
        if source is None:
            raise StageError(f"found no rig {entry.rig} in this worker's settings, expected the service's own rigs")
        rig = rig_argument(source, self._folder.rig(entry.rig or "") / "calibration.toml")
        arguments = record_arguments(entry.request, rig, source.devices, recording)
        control = Control(self._folder.entry(entry.id) / "stop", self._folder.entry(entry.id) / "save")
        try:
            await self._supervise(entry, stage, arguments, [self._folder.rig(entry.rig or "")], control=control)
        except StageError:
            if not recording.exists():  # else it was kept, and says itself what it lacks
                raise
            reporter = Reporter(self._store, entry.id, stage)
            reporter(1.0, f"kept, incomplete: {read_manifest(recording).reason}")
            reporter.close()

    async def _reconstruct(self, entry: Entry, stage: str) -> None:
        run = self._folder.run(entry.id)
        if _finished(run, entry.restart):  # by a worker that was killed before it could say so
            return
        assert entry.capture is not None
        recording = self._folder.recording(entry.capture)
        arguments = reconstruct_arguments(entry.request, stage, recording, run, entry.restart)
        try:
            await self._supervise(entry, stage, arguments, [], trains=True)
        finally:
            self._store.artefacts.catalogue(entry.id, run, run_artefacts(run))

    async def _task(self, entry: Entry, stage: str) -> None:
        out = self._folder.out(entry.id)
        self._folder.remove(out)  # an attempt that was interrupted
        out.mkdir(parents=True)
        assert entry.capture is not None
        run = self._folder.run(entry.request["job"]) if "job" in entry.request else None
        arguments = task_arguments(entry.request, self._folder.recording(entry.capture), run, out)
        printed = out / "result.json" if "--json" in arguments else None
        await self._supervise(entry, stage, arguments, [], stdout=printed)
        self._store.artefacts.catalogue(entry.id, out, plain_files(out))

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
    ) -> None:
        reporter = Reporter(self._store, entry.id, stage)
        try:
            await supervise(
                [*self._settings.stage_command, *arguments],
                folders=[self._folder.entry(entry.id), *locks, *(self._accelerator() if trains else ())],
                log=self._folder.log(entry.id),
                on_progress=reporter,
                grace_s=self._settings.grace_s,
                control=control,
                stdout=stdout,
                answers=entry.type in ANSWERS,
                environment={} if self._settings.gpu is None else {"CUDA_VISIBLE_DEVICES": str(self._settings.gpu)},
            )
        except (Spike4dgsError, OSError) as error:
            reporter.close(str(error))
            raise
        reporter.close()

    def _accelerator(self) -> Iterator[Path]:
        """The folder whose flock says that the accelerator is taken; on this host, not on shared storage."""
        if self._settings.gpu is not None:
            folder = self._settings.locks / f"gpu{self._settings.gpu}"
            folder.mkdir(parents=True, exist_ok=True)
            yield folder


def _finished(run: Path, restart: dict[str, Any] | None) -> bool:
    if not (run / "run.json").exists():
        return False
    document = json.loads((run / "run.json").read_text())
    attempt = 0 if restart is None else restart["attempt"]
    return document.get("status") == "finished" and document.get("attempt", 0) == attempt
