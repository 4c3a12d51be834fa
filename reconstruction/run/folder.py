"""The run folder: `run.json`, which says how far the run is, and arrays beside it."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from numpy.typing import NDArray

from acquisition.arrays import read_array, write_array
from acquisition.durable import write_json
from reconstruction.errors import BadRunError
from reconstruction.run.configuration import RESULTS, ReconstructionConfig
from reconstruction.run.decisions import Amendment, Decision, Plan
from reconstruction.run.document import SCHEMA, RunDocument
from reconstruction.run.parts import PartFolder

PREVIEW = "preview.png", "preview.json"  # what a training shows of itself, and how far it was


class RunFolder:
    """The folder `path` of one run and its `document`."""

    def __init__(self, path: Path, document: RunDocument):
        self.path = path
        self.document = document

    @classmethod
    def start(
        cls, path: Path, config: ReconstructionConfig, recording: Path, revision: str, *, attempt: int = 0
    ) -> RunFolder:
        """Make a new run, or resume an unfinished one with the same configuration; refuse any other folder.

        A finished one is resumed only by an `attempt` that is yet to `forget` stages of it.
        """
        if (path / "run.json").exists():
            run = cls.open(path)
            if run.document.status == "finished" and attempt <= run.document.attempt:
                raise BadRunError("found a finished run", "a new folder", "give another --out", where=path)
            if run.config != config or run.recording != recording.resolve():
                raise BadRunError(
                    f"found a run ({run.document.status}) with another configuration or recording",
                    do="repeat its options to resume it, or give another --out",
                    where=path,
                )
            return run
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise BadRunError("found something that is not a run", "a new or empty folder", where=path)
        path.mkdir(parents=True, exist_ok=True)
        run = cls(path, RunDocument(str(recording.resolve()), config, revision))
        run.save()
        return run

    @classmethod
    def open(cls, path: Path) -> RunFolder:
        """Open an existing run; raises BadRunError where there is none."""
        file = path / "run.json"
        try:
            plain = json.loads(file.read_text())
        except (OSError, ValueError) as error:
            raise BadRunError("found no readable run.json", "a run folder of `reconstruct`", where=path) from error
        if plain.get("schema") != SCHEMA:
            raise BadRunError(f"found schema {plain.get('schema')}", f"{SCHEMA}", where=file)
        return cls(path, RunDocument.from_json(plain))

    @property
    def config(self) -> ReconstructionConfig:
        """The configuration that the run was started with."""
        return self.document.configuration

    @property
    def recording(self) -> Path:
        """The recording that the run reads."""
        return Path(self.document.recording)

    @property
    def plan(self) -> Plan:
        """The plan with all amendments; raises BadRunError before the plan stage."""
        plan = self.document.plan
        if plan is None:
            raise BadRunError("found no plan", "the plan stage to have run first", where=self.path)
        return plan

    def amend(self, stage: str, decision: Decision, **changes: str | bool | int) -> None:
        """Add a decision of a later stage to the plan, with what it changes; an older one about the same gives way."""
        others = [a for a in self.document.amendments if a.decision.about != decision.about]
        self.document.amendments = [*others, Amendment(stage, decision, changes)]
        self.save()

    @property
    def checkpoint(self) -> Path:
        """The newest state of training."""
        return self.path / "checkpoint.pt"

    def snapshots(self) -> list[Path]:
        """Return the states kept along the way, oldest first, for the error-against-time curve."""
        return sorted((self.path / "snapshots").glob("*.pt"))

    def has(self, stage: str) -> bool:
        """Return whether a stage is complete."""
        return stage in self.document.seconds

    def finish_stage(self, stage: str, seconds: float, *, last: bool = False) -> None:
        """Record a stage as complete, and with the `last` one the run: at once, lest a kill come between the two."""
        self.document.seconds[stage] = round(seconds, 3)
        if last:
            self.document.status = "finished"
        self.save()

    def forget(self, stages: Sequence[str], attempt: int) -> None:
        """Undo `stages`, so that they are run anew; once for each number of `attempt`, which grows.

        A stage writes over what an earlier attempt left; what it may not write again (RESULTS) is removed, and so is
        what it would resume from.
        """
        if self.document.attempt >= attempt:
            return
        self.document.status = "unfinished"
        results = [RESULTS[stage] for stage in stages if stage in RESULTS]
        for told in (name for result in results for name in result.told):
            setattr(self.document, told, None)
        self.document.undo_amendments(stages)
        for by_stage in (self.document.seconds, self.document.warnings):
            for stage in stages:
                by_stage.pop(stage, None)
        self.save()
        for path in (path for result in results for name in result.files for path in self.path.glob(name)):
            path.unlink(missing_ok=True)
        if "train" in stages:
            for path in [self.checkpoint, *self.snapshots(), *(self.path / name for name in PREVIEW)]:
                path.unlink(missing_ok=True)
            PartFolder(self.path).forget()
        self.document.attempt = attempt
        self.save()

    def save(self) -> None:
        """Write `run.json`."""
        write_json(self.path / "run.json", self.document.to_json())

    def write_array(self, name: str, array: NDArray) -> None:
        """Write an array durably as NAME.npy."""
        file = self.path / f"{name}.npy"
        file.parent.mkdir(parents=True, exist_ok=True)
        write_array(file, array)

    def has_array(self, name: str) -> bool:
        """Return whether there is an array of this name."""
        return (self.path / f"{name}.npy").exists()

    def read_array(self, name: str) -> NDArray:
        """Read an array that `write_array` wrote; raises BadRunError where an earlier stage is missing."""
        file = self.path / f"{name}.npy"
        if not self.has_array(name):
            raise BadRunError("not found", "the artefact of an earlier stage", "run that stage first", where=file)
        return read_array(file)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder against a second process; raises BadRunError when one is at work in it."""
        with (self.path / ".lock").open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise BadRunError(
                    "another process is at work in this run", do="wait for it or stop it", where=self.path
                ) from error
            yield
