"""`bench paper`: the protocol of the paper, its tables and its diagrams."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.bench_document import BenchDocument
from server.cli.bench_recordings import recording
from server.cli.progress import progress_of

if TYPE_CHECKING:
    from reconstruction.bench.paper.method import Protocol

QUICK_TICKS, QUICK_RIG = 120, "ci3x3"


@dataclass(frozen=True)
class PaperBench:
    """What was asked for: scenes and tables (NAME,...; None: all), and the options of the command."""

    scenes: str | None
    tables: str | None
    quick: bool
    keep: bool
    limit_s: float | None

    @cached_property
    def protocol(self) -> Protocol:
        """The part of the protocol that was asked for."""
        from reconstruction.bench.paper.protocol import PROTOCOL, QUICK

        found = QUICK if self.quick else PROTOCOL
        if self.tables:
            found = found.of(tuple(self.tables.split(",")))
        return found.on(tuple(self.scenes.split(","))) if self.scenes else found

    def run(self, work: Path) -> BenchDocument:
        """Run it in `work`, where what was run before is found again."""
        from reconstruction.bench.paper.bench import Clock, bench_paper
        from reconstruction.bench.paper.run import Laboratory

        laboratory = Laboratory(work / "paper", lambda *about: self._recording(work, *about), progress_of, self.keep)
        return bench_paper(self.protocol, laboratory, progress_of("paper"), Clock(self.limit_s))

    def write(self, out: Path, found: dict) -> None:
        """Write the tables and diagrams of the document `found` into `out`."""
        from reconstruction.bench.paper.diagrams import write_diagrams
        from reconstruction.bench.paper.others import open_others
        from reconstruction.bench.paper.tables import write_tables

        others = open_others(out)
        write_tables(out / "paper.md", found, self.protocol, others)
        write_diagrams(out, found, others)

    def _recording(self, work: Path, scene: str, seed: int) -> Path:
        if self.quick:
            return recording(scene, seed, work / "paper" / "quick", QUICK_TICKS, QUICK_RIG)
        return recording(scene, seed, work)
