"""Reconstructs, scores and keeps single cells, so that a stopped bench goes on where it was."""

import json
import math
import shutil
import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from acquisition.bench_document import Stolen, device
from acquisition.durable import write_json
from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from acquisition.revision import code_revision
from reconstruction.bench.conventions import KnownRecording
from reconstruction.bench.pace import step_ms
from reconstruction.bench.paper.changed import changed
from reconstruction.bench.paper.digest import asked_digest, cell_digest, this_code
from reconstruction.bench.paper.method import Cell, Effort
from reconstruction.bench.score_run import score_run
from reconstruction.errors import ReconstructionError
from reconstruction.pipeline.budget import StoppedError
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.folder import RunFolder

SCORES = "scores.json"
QUIET = 0.1  # share of the processors' time that others may take from a run before it is repeated
SLOW = 1.25  # times the fastest fixed step so far that one beside a run of seconds may take before it is repeated
TRIES = 2  # runs of one cell at most; the quietest counts
WARM_UP = Effort(steps=2)  # length of the run that loads what a process loads once, and is thrown away


@dataclass
class Laboratory:
    """Runs cells in the folder `work` on the recordings that `recording_of` returns for a scene and seed.

    `earlier` has rows of an earlier document by the names of their cells, so that a bench goes on where its folder is
    gone. With `keep` results of other code are taken as they are. The methods named by `floors` are scored beside the
    floors. A refusal or failure is kept as well, with its reason, so that one run does not end a bench of hours.
    `pace` times a fixed step, in ms, before and after each run.
    """

    work: Path
    recording_of: Callable[[str, int], Path]
    progress_of: Callable[[str], Progress]
    keep: bool = False
    floors: tuple[str, ...] = ()
    warm: bool = False
    earlier: Mapping[str, dict] = field(default_factory=dict)
    pace: Callable[[], float] = step_ms
    fastest_ms: float = math.inf

    def kept(self, cell: Cell) -> Path | None:
        """Return the folder of a cell's run by this code, or with `keep` by any code; None where there is none.

        With `keep` no recording is made only to compare its digest.
        """
        found = [file.parent for file in (self.work / "cells" / cell.name).glob(f"*/{SCORES}")]
        if found and self.keep:
            own = this_code(cell.method)
            return max(found, key=lambda run: (_row(run).get("code") == own, (run / SCORES).stat().st_mtime))
        return self._own(cell) if found and self._own(cell) in found else None

    def known(self, cell: Cell) -> dict | None:
        """Return the row that was kept of a cell, in the folder or by an earlier document; None where there is none."""
        folder = self.kept(cell)
        if folder:
            row = _row(folder)
            return row if row.get("code") == this_code(cell.method) else row | {"kept": True}
        if (known := self.earlier.get(cell.name)) and known["asked"] == asked_digest(cell):
            return known
        return self.older(cell) if self.keep else None

    def older(self, cell: Cell) -> dict | None:
        """Return an earlier document's row of a cell of this name, marked as kept; None where it has none."""
        row = self.earlier.get(cell.name)
        return row and row | {"kept": True}

    def runs(self, cells: Iterable[Cell]) -> list[tuple[KnownRecording, RunFolder]]:
        """Return each cell's recording and run, made where there is none; raises ReconstructionError if refused."""
        found = []
        for cell in cells:
            folder = self.kept(cell)
            row = self.result(cell) if folder is None else _row(folder)
            if "refused" in row:
                raise ReconstructionError(row["refused"])
            recording = KnownRecording(cell.scene, cell.seed, self.recording_of(cell.scene, cell.seed))
            found.append((recording, RunFolder.open(self.kept(cell) or self._own(cell))))
        return found

    def _own(self, cell: Cell) -> Path:
        return self.work / "cells" / cell.name / cell_digest(cell, self.recording_of(cell.scene, cell.seed))

    def result(self, cell: Cell) -> dict:
        """Run a cell and return its row, or `refused` with the reason or the failure."""
        config = cell.method.config(cell.effort, cell.seed)  # refuses an unknown name before any work
        recording = self.recording_of(cell.scene, cell.seed)
        out = self._own(cell)
        for left_over in out.parent.glob("*"):  # by a run that was stopped on the way
            if not (left_over / SCORES).exists():
                shutil.rmtree(left_over)
        try:
            found = self._quietest(cell, config, recording, out)
        except ReconstructionError as refusal:
            if isinstance(refusal, StoppedError):
                raise
            found = {"refused": self._reason(refusal)}
        except Exception as failure:  # noqa: BLE001 - any failure of a run is its result
            traceback.print_exc()
            found = {"refused": f"the program failed, {type(failure).__name__}: {self._reason(failure)}"}
        row = {"method": cell.method.name, "scene": cell.scene, "seed": cell.seed, "effort": cell.effort.label}
        day = datetime.now(UTC).date().isoformat()
        row |= {"budget_s": cell.effort.budget_s, **device(), "revision": code_revision(), "day": day}
        row |= {"code": this_code(cell.method), "asked": asked_digest(cell)}
        found = row | found
        out.mkdir(parents=True, exist_ok=True)
        write_json(out / SCORES, found)
        _reduce(out)
        return found

    def _reason(self, error: Exception) -> str:
        """Return the words of an error on one line, without the path of this machine to the folder."""
        return " ".join(str(error).replace(f"{self.work}/", "").split())

    def _quietest(self, cell: Cell, config: ReconstructionConfig, recording: Path, out: Path) -> dict:
        """Run a cell until others leave it in peace, TRIES times at most, and return the scores of the quietest run.

        That is the one whose machine made most steps in the time that others left it.
        """
        tried: list[tuple[dict, Path]] = []
        while not tried or (len(tried) < TRIES and self._is_disturbed(cell, tried[-1][0])):
            place = out.with_name(f"{out.name}.{len(tried)}")
            tried.append((self._run(cell, config, recording, place), place))
        best, kept = min(tried, key=lambda one: one[0]["step_ms"] / (1 - one[0]["stolen"]))
        kept.rename(out)
        for _, place in tried:
            shutil.rmtree(place, ignore_errors=True)
        return best

    def _is_disturbed(self, cell: Cell, row: dict) -> bool:
        """Return whether others took time from a run, or a run of so many seconds had a slower machine than others."""
        return row["stolen"] > QUIET or (cell.effort.budget_s is not None and row["step_ms"] > SLOW * self.fastest_ms)

    def _run(self, cell: Cell, config: ReconstructionConfig, recording: Path, out: Path) -> dict:
        change = cell.method.change
        own = self.work / "recordings" / f"{recording.name}-{change.label}"
        path = changed(recording, own, change, cell.seed)
        self._warm_up(recording)
        before_ms, others = self.pace(), Stolen()
        run = reconstruct(path, out, config, self.progress_of, last="train")
        share, after_ms = round(others.share(), 4), self.pace()
        self.fastest_ms = min(self.fastest_ms, before_ms, after_ms)
        scores = score_run(run, Recording.open(recording), floors=cell.method.name in self.floors)
        step = round((before_ms + after_ms) / 2, 2)
        return {"seconds": scores["curve"][-1]["seconds"], "stolen": share, "step_ms": step, **scores}

    def _warm_up(self, recording: Path) -> None:
        """Run the pipeline once and throw the result away, so that no run's clock counts the loading of libraries."""
        if self.warm:
            return
        out = self.work / "warm-up"
        shutil.rmtree(out, ignore_errors=True)
        config = ReconstructionConfig(steps=WARM_UP.steps, budget_s=None, gaussians=1000)
        reconstruct(recording, out, config, self.progress_of, last="train")
        shutil.rmtree(out)
        self.warm = True


def _row(run: Path) -> dict:
    return json.loads((run / SCORES).read_text())


def _reduce(out: Path) -> None:
    """Delete all of a run but its documents, poses and last state; the rest is large and can be made again."""
    snapshots = sorted((out / "snapshots").glob("*.pt"))
    kept = {out / SCORES, out / "run.json", out / "poses", out / "snapshots", *snapshots[-1:]}
    for path in [*out.iterdir(), *snapshots]:
        if path not in kept:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
