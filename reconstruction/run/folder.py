"""The run folder: every artefact under its name, and `run.json`, which says how far the run is."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.durable import write_array, write_json
from reconstruction.errors import BadRunError
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.plan import Plan

SCHEMA = 1


class RunFolder:
    """Paths and `run.json` of one run; `document` holds status, configuration, plan and seconds by stage."""

    def __init__(self, path: Path, document: dict):
        self.path = path
        self.document = document

    @classmethod
    def start(cls, path: Path, config: ReconstructionConfig, recording: Path, facts: dict) -> RunFolder:
        """Make a new run, or resume an unfinished one with the same configuration; refuses any other folder."""
        if (path / "run.json").exists():
            run = cls.open(path)
            if run.document["status"] == "finished":
                raise BadRunError("found a finished run", "a new folder", "give another --out", where=path)
            if run.config != config or run.document["recording"] != str(recording.resolve()):
                raise BadRunError(
                    "found an unfinished run with another configuration or recording",
                    do="repeat its options to resume it, or give another --out",
                    where=path,
                )
            return run
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise BadRunError("found something that is not a run", "a new or empty folder", where=path)
        path.mkdir(parents=True, exist_ok=True)
        document = {
            "schema": SCHEMA,
            "status": "unfinished",
            "recording": str(recording.resolve()),
            "configuration": config.to_json(),
            "seed": config.seed,
            "seconds": {},
            **facts,
        }
        run = cls(path, document)
        run.save()
        return run

    @classmethod
    def open(cls, path: Path) -> RunFolder:
        """An existing run; raises BadRunError where there is none."""
        file = path / "run.json"
        try:
            document = json.loads(file.read_text())
        except (OSError, ValueError) as error:
            raise BadRunError("found no readable run.json", "a run folder of `reconstruct`", where=path) from error
        if document.get("schema") != SCHEMA:
            raise BadRunError(f"found schema {document.get('schema')}", f"{SCHEMA}", where=file)
        return cls(path, document)

    @property
    def config(self) -> ReconstructionConfig:
        """The configuration the run was started with."""
        return ReconstructionConfig.from_json(self.document["configuration"])

    @property
    def recording(self) -> Path:
        """The recording the run reads."""
        return Path(self.document["recording"])

    @property
    def plan(self) -> Plan:
        """The plan; raises BadRunError before the plan stage."""
        if "plan" not in self.document:
            raise BadRunError("found no plan", "the plan stage to have run first", where=self.path)
        return Plan.from_json(self.document["plan"])

    @property
    def checkpoint(self) -> Path:
        """The newest state of training."""
        return self.path / "checkpoint.pt"

    def white(self) -> float:
        """What is shown as white, in spikes per tick: the 99.9th percentile of the still images, mean over the views.

        Raises BadRunError before the images stage.
        """
        stills = (self.read_array(f"images/image_{view}") for view in self.plan.views)
        return float(np.mean([np.percentile(image, 99.9) for image in stills]))

    def snapshots(self) -> list[Path]:
        """States kept along the way, oldest first, for the error-against-time curve."""
        return sorted((self.path / "snapshots").glob("*.pt"))

    def has(self, stage: str) -> bool:
        """Whether a stage is complete."""
        return stage in self.document["seconds"]

    def finish_stage(self, stage: str, seconds: float, *, last: bool = False) -> None:
        """Record a stage as complete, and with the `last` one the run: at once, lest a kill come between the two."""
        self.document["seconds"][stage] = round(seconds, 3)
        if last:
            self.document["status"] = "finished"
        self.save()

    def forget(self, stages: Sequence[str], attempt: int) -> None:
        """Undo `stages`, so that they are run anew; once for each number of `attempt`, which grows.

        Later stages write over what earlier attempts left; only what they would resume from is removed.
        """
        if self.document.get("attempt", 0) >= attempt:
            return
        self.document["status"] = "unfinished"
        self.document["seconds"] = {k: v for k, v in self.document["seconds"].items() if k not in stages}
        self.save()
        if "train" in stages:
            for path in [self.checkpoint, *self.snapshots()]:
                path.unlink(missing_ok=True)
        self.document["attempt"] = attempt
        self.save()

    def save(self) -> None:
        """Write `run.json`."""
        write_json(self.path / "run.json", self.document)

    def write_array(self, name: str, array: NDArray) -> None:
        """Keep an array as NAME.npy, durably."""
        file = self.path / f"{name}.npy"
        file.parent.mkdir(parents=True, exist_ok=True)
        write_array(file, array)

    def read_array(self, name: str) -> NDArray:
        """An array written by `write_array`; raises BadRunError where an earlier stage is missing."""
        file = self.path / f"{name}.npy"
        if not file.exists():
            raise BadRunError("not found", "the artefact of an earlier stage", "run that stage first", where=file)
        return np.load(file)

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
