"""Options, recordings and the form of all benches."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from acquisition.bench_document import BenchDocument
from acquisition.errors import AcquisitionError
from acquisition.progress import Progress
from acquisition.scenes.catalog import EVALUATION_SEEDS, scenes_named
from acquisition.spikes.sensor import SensorKind

TICKS, QUICK_TICKS, QUICK_RIG = 400, 120, "ci3x3"
THIS = (sys.executable, "-m", "server.cli")  # this command line, in a process of its own


@dataclass(frozen=True)
class Asked:
    """The options of the command; a stopped bench resumes from what is in `work`.

    `earlier`: the document that an earlier call has left, whose rows benches of cells, and `long`, take.
    """

    work: Path
    progress_of: Callable[[str], Progress]
    earlier: Path | None = None
    scenes: str | None = None
    quick: bool = False
    metric_files: Path | None = None
    tables: str | None = None
    limit_s: float | None = None
    keep: bool = False
    against: Path | None = None

    def named(self, default: tuple[str, ...]) -> tuple[str, ...]:
        """Return the scenes asked for, or `default`; only the first of them with --quick."""
        found = scenes_named(self.scenes) if self.scenes else default
        return found[:1] if self.quick else found

    def earlier_document(self) -> dict:
        """Return the document that an earlier call has left; empty where there is none."""
        return json.loads(self.earlier.read_text()) if self.earlier and self.earlier.exists() else {}

    def earlier_rows(self) -> dict[str, dict]:
        """Return the runs of cells of the earlier document, the refused ones as well, by the names of their cells."""
        from reconstruction.bench.paper.summary import name_of  # late, for a capture host has no torch

        found = self.earlier_document()
        rows = [row for part in ("rows", "refused") for row in found.get(part, []) if "asked" in row]
        runs = ({key: row[key] for key in row if key != "kept"} for row in rows)
        return {name_of(run): run for run in runs}

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds of the evaluation scenes; only the first of them with --quick."""
        return EVALUATION_SEEDS[:1] if self.quick else EVALUATION_SEEDS


class Bench(NamedTuple):
    """One measurement: `run` measures, `draw` writes the pictures of a document into a folder.

    `trains`: whether one pool of threads does all the work, in this process.
    """

    about: str
    run: Callable[[Asked], BenchDocument]
    draw: Callable[[Asked, Path, dict], None] = lambda asked, out, found: None
    trains: bool = False


def recording(
    scene: str,
    seed: int,
    work: Path,
    ticks: int = TICKS,
    rig: str | None = None,
    *,
    size: str | None = None,
    sensor: SensorKind | None = None,
) -> Path:
    """Return the recording of a scene and seed in `work`, simulated if it is not there yet.

    `simulate` runs in a process of its own, where idle threads sleep: it has a pool for each of nine cameras. Raises
    AcquisitionError if it fails.
    """
    path = work / f"{scene}-{seed}"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        options = {"scene": scene, "seed": seed, "ticks": ticks, "out": path}
        options |= {"rig": rig, "size": size, "sensor": sensor}
        command = [*THIS, "simulate"]
        command += [word for k, v in options.items() if v is not None for word in (f"--{k}", str(v))]
        if subprocess.run(command, stdout=sys.stderr).returncode:
            raise AcquisitionError("found that simulate failed", "a recording", "its reason is above", where=path.name)
    return path
