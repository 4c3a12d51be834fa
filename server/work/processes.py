"""The processes of stages: what each locks, where it reports, and the mark that says it has finished."""

import errno
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from acquisition.errors import DiskError
from rigs.errors import Spike4dgsError
from server.part_queue import attempt_of
from server.settings import STAGE_COMMAND, ServiceSettings
from server.store.store import Store
from server.store.tables import Entry
from server.work.part_reporter import PartReporter
from server.work.reporter import Reporter
from server.work.supervisor import Control, supervise

ANSWERS = ("check-rig", "verify", "preflight")  # whose exit code 1 is an answer, not a failure


def no_room(where: object) -> DiskError:
    """Return the error of a full disk at `where`."""
    return DiskError("found no space left", "some", "free some and resume the job", where=where)


def is_full(error: OSError) -> bool:
    """Return whether an error says that a disk is full."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT)


def as_told(error: Exception, where: object) -> Exception:
    """Return an error as people are told of it: of a full disk, that there is no room at `where`."""
    return no_room(where) if isinstance(error, OSError) and is_full(error) else error


def attempt_of_run(run: Path) -> int:
    """Return how often the stages of a run were forgotten to be run again, as it says itself."""
    return _told(run).get("attempt", 0)


def is_finished(run: Path, stage: str, entry: Entry) -> bool:
    """Return whether the run itself says that a stage is finished; its worker may have died before it could."""
    document = _told(run)
    return stage in document.get("seconds", {}) and document.get("attempt", 0) == attempt_of(entry)


def _told(run: Path) -> dict[str, Any]:
    document = run / "run.json"
    return json.loads(document.read_text()) if document.exists() else {}


class Processes:
    """Runs the processes of a service's stages."""

    def __init__(self, settings: ServiceSettings, store: Store) -> None:
        self._settings = settings
        self._store = store

    async def run(
        self,
        entry: Entry,
        stage: str,
        arguments: Sequence[str],
        *,
        locks: Sequence[Path] = (),
        control: Control | None = None,
        stdout: Path | None = None,
        repeats: bool = False,
        is_due: Callable[[], bool] = lambda: True,
        ends_in_order: bool = False,
        begins: float = 0.0,
    ) -> None:
        """Run a stage's process, holding `locks`; its progress and its error go into the tables.

        One that `repeats` leaves no mark, since its results do not outlive its worker. `begins` is the share of the
        stage that was done before. Raises as `supervise`.
        """
        reporter = Reporter(self._store, entry.id, stage, begins)
        folder = self._store.folder
        try:
            await supervise(
                [*self._settings.stage_command, *arguments],
                folders=[folder.entry(entry.id), *locks, *self._accelerator(entry)],
                log=folder.log(entry.id),
                finished=None if repeats else self.finished(entry, stage),
                is_due=is_due,
                ends_in_order=ends_in_order,
                on_progress=reporter,
                on_warning=reporter.warn,
                grace_s=self._settings.grace_s,
                control=control,
                stdout=stdout,
                answers=entry.type in ANSWERS,
                environment=self._environment,
            )
        except (Spike4dgsError, OSError) as error:
            reporter.close(as_told(error, folder.path))
            raise
        reporter.close()

    async def run_part(
        self, entry: Entry, arguments: Sequence[str], reporter: PartReporter, is_due: Callable[[], bool]
    ) -> None:
        """Run the process of one part of a training, beside those of other parts; raises as `supervise`."""
        forks = self._settings.stage_command == STAGE_COMMAND
        try:
            await supervise(
                [*(() if forks else self._settings.stage_command), *arguments],
                forks=forks,
                folders=list(self._accelerator(entry)),
                beside=self._store.folder.parts(entry.id),
                log=self._store.folder.log(entry.id),
                is_due=is_due,
                on_progress=reporter,
                on_warning=reporter.warn,
                grace_s=self._settings.grace_s,
                environment=self._environment,
            )
        finally:
            reporter.close()

    @property
    def _environment(self) -> dict[str, str]:
        gpu = self._settings.gpu
        return {} if gpu is None else {"CUDA_VISIBLE_DEVICES": str(gpu)}

    def finished(self, entry: Entry, stage: str) -> Path:
        """Return the mark of a finished stage; a restart, which counts attempts, begins without."""
        return self._store.folder.entry(entry.id) / f"{stage}.{attempt_of(entry)}.finished"

    def _accelerator(self, entry: Entry) -> Iterator[Path]:
        """Yield the folder whose flock says that the accelerator is taken; it lies on this host, not on a share."""
        if self._settings.gpu is not None and entry.type == "reconstruct":
            folder = self._settings.locks / f"gpu{self._settings.gpu}"
            folder.mkdir(parents=True, exist_ok=True)
            yield folder
