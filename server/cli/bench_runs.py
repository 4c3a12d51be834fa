"""The benches by name: what each runs and what it is seen by. Imports are late: a capture host has no torch."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.bench_document import BenchDocument
from acquisition.devices.bench import parser_rows
from acquisition.recording.bench import QUICK, Schedule, bench_recorder
from acquisition.scenes.catalog import DEVELOPMENT, EVALUATION, EVALUATION_SEEDS
from server.cli.bench_recordings import recorded, recording
from server.cli.progress import progress_of

if TYPE_CHECKING:
    from reconstruction.bench.paper.method import Protocol
    from reconstruction.bench.paper.run import Laboratory
    from reconstruction.bench.training import Clip
    from reconstruction.run.folder import RunFolder

_PARSED_BYTES = 10_000_000_000
QUICK_TICKS, QUICK_RIG = 120, "ci3x3"


@dataclass(frozen=True)
class Asked:
    """The options of the command; `work` keeps what a stopped bench resumes from."""

    work: Path
    scenes: str | None = None
    quick: bool = False
    metric_files: Path | None = None
    tables: str | None = None
    limit_s: float | None = None
    keep: bool = False

    def named(self, default: tuple[str, ...]) -> tuple[str, ...]:
        """The scenes asked for; the first of them alone with --quick."""
        found = tuple(self.scenes.split(",")) if self.scenes else default
        return found[:1] if self.quick else found


@dataclass(frozen=True)
class Bench(ABC):
    """One measurement."""

    asked: Asked

    @abstractmethod
    def run(self) -> BenchDocument:
        """Measure."""

    def draw(self, out: Path, found: dict) -> None:  # noqa: B027 - where numbers say it all
        """Write what the document `found` is seen by into `out`."""


class Images(Bench):
    """Spikes to images."""

    def run(self) -> BenchDocument:
        from reconstruction.bench.images import Extent, ImageBench

        names = self.asked.named(EVALUATION)
        seeds = EVALUATION_SEEDS[:1] if self.asked.quick else EVALUATION_SEEDS
        extent = Extent(names, seeds, sweeps=not self.asked.quick)
        return ImageBench(extent, self.asked.work / "images", self.asked.metric_files).run(progress_of("images"))

    def draw(self, out: Path, found: dict) -> None:
        from reconstruction.bench.contact_sheet import write_sheet
        from reconstruction.bench.plot_images import plot_images

        plot_images(out / "images.png", found)
        write_sheet(out / "images-sheet.png", self.asked.work / "images")


class Pixels(Bench):
    """Pixels calibrated, or taken as even."""

    def run(self) -> BenchDocument:
        from reconstruction.bench.pixels import bench_pixels

        seeds = EVALUATION_SEEDS[:1] if self.asked.quick else EVALUATION_SEEDS
        return bench_pixels(self.asked.scenes or "fan_and_ball", seeds)


class Poses(Bench):
    """Where the cameras stand."""

    def run(self) -> BenchDocument:
        from reconstruction.bench.pose_clip import PoseClip
        from reconstruction.bench.pose_methods import BOARD_SCENE, BOARD_TICKS
        from reconstruction.bench.poses import bench_poses

        work, quick = self.asked.work, self.asked.quick
        clips = [PoseClip(*found) for found in recorded(self.asked.named(EVALUATION), work)]
        boards = [] if quick else [PoseClip(*found) for found in recorded((BOARD_SCENE,), work, BOARD_TICKS)]
        return bench_poses(clips, boards[0] if boards else None, work / "poses", progress_of("poses"), quick=quick)

    def draw(self, out: Path, found: dict) -> None:
        from reconstruction.bench.plot_poses import plot_poses

        plot_poses(out / "poses.png", found)


class Rasterizer(Bench):
    """Gaussians to pixels."""

    def run(self) -> BenchDocument:
        from reconstruction.bench.rasterizer import bench_rasterizer

        return bench_rasterizer()


class Recorder(Bench):
    """The rings and writers on the disk, and the parser that feeds them."""

    def run(self) -> BenchDocument:
        quick = self.asked.quick
        schedule, parsed = (QUICK, _PARSED_BYTES // 10) if quick else (Schedule(), _PARSED_BYTES)
        document = bench_recorder(self.asked.work / "recorder", schedule, progress_of("recorder"))
        rows, summary = parser_rows(parsed, document.summary["memcpy_gb_s"])
        document.rows += rows
        document.summary |= summary
        return document


class Training(Bench):
    """Whole reconstructions at several budgets, and one choice changed at a time."""

    def run(self) -> BenchDocument:
        from reconstruction.bench.training import Clip, bench_training
        from reconstruction.bench.variants import AUTO, VARIANTS

        named, variants = self.asked.named((*EVALUATION, *DEVELOPMENT)), list(VARIANTS)
        if self.asked.scenes:  # a scene that is asked for is run by the whole engine, whichever kind it is
            variants = [replace(v, scenes=named) if v is AUTO else v for v in variants]
        if self.asked.quick:
            variants = [replace(v, budgets_s=v.budgets_s[1:2]) for v in variants[:1]]
        clips = [Clip(scene, seed, path) for scene, seed, path in recorded(named, self.asked.work)]
        document = bench_training(clips, variants, self.asked.work, progress_of)
        document.omissions.append("one seed a scene")
        return document

    def draw(self, out: Path, found: dict) -> None:
        from reconstruction.bench.contact_sheet import write_run_strip, write_sheet
        from reconstruction.bench.plot import plot_training

        plot_training(out / "training.png", found)
        longest = max(r["budget_s"] for r in found["rows"] if r["method"] == "auto")
        strips = self.asked.work / "strips"
        for run in sorted(self.asked.work.glob(f"*-auto-{longest:g}s")):
            write_run_strip(strips / f"{run.name}.png", run)
        write_sheet(out / "training-sheet.png", strips, most_px=1200)


class LeaveOut(Bench):
    """Plans against everything on."""

    def run(self) -> BenchDocument:
        from reconstruction.bench.leave_out import bench_leave_out
        from reconstruction.bench.paper.bench import Clock

        asked = self.asked
        left = Clock(asked.limit_s).until()
        return bench_leave_out(asked.work / "leave-out", progress_of("leave-out"), quick=asked.quick, time_left=left)

    def draw(self, out: Path, found: dict) -> None:
        from reconstruction.bench.plot_leave_out import plot_leave_out

        plot_leave_out(out / "leave-out.png", found)


class Paper(Bench):
    """The protocol of the paper, its tables and its diagrams."""

    @cached_property
    def protocol(self) -> Protocol:
        """The part of the protocol that was asked for."""
        from reconstruction.bench.paper.protocol import PROTOCOL, QUICK

        found = QUICK if self.asked.quick else PROTOCOL
        if self.asked.tables:
            found = found.of(tuple(self.asked.tables.split(",")))
        return found.on(tuple(self.asked.scenes.split(","))) if self.asked.scenes else found

    def run(self) -> BenchDocument:
        from reconstruction.bench.paper.bench import Clock, bench_paper

        clock = Clock(self.asked.limit_s)
        return bench_paper(self.protocol, laboratory(self.asked), progress_of("paper"), clock)

    def draw(self, out: Path, found: dict) -> None:
        from reconstruction.bench.paper.diagrams import write_diagrams
        from reconstruction.bench.paper.others import open_others
        from reconstruction.bench.paper.tables import write_tables

        others = open_others(out)
        write_tables(out / "paper.md", found, self.protocol, others)
        write_diagrams(out, found, others)


class Viewpoints(Bench):
    """Views that nobody captured, of the runs that `paper` makes at a minute."""

    @cached_property
    def runs(self) -> tuple[Sequence[Clip], Sequence[RunFolder]]:
        """A recording of each scene, and the run of it; made where there is none."""
        from reconstruction.bench.paper.protocol import LONG, OURS, QUICK
        from reconstruction.bench.training import Clip
        from reconstruction.run.folder import RunFolder

        method, effort = OURS.method, LONG
        scenes = self.asked.named(EVALUATION)
        if self.asked.quick:
            method, effort, scenes = QUICK.tables[0].rows[0].method, QUICK.batches[0].efforts[0], DEVELOPMENT
        assert method is not None
        bench = laboratory(self.asked)
        cells = [method.on(scene, effort) for scene in scenes]
        clips = [Clip(cell.scene, cell.seed, bench.recording_of(cell.scene, cell.seed)) for cell in cells]
        return clips, [RunFolder.open(bench.folder(cell)) for cell in cells]

    def run(self) -> BenchDocument:
        from reconstruction.bench.viewpoints import bench_viewpoints

        return bench_viewpoints(*self.runs, progress_of("viewpoints"))

    def draw(self, out: Path, found: dict) -> None:
        from reconstruction.bench.plot_viewpoints import plot_viewpoints, write_flythroughs, write_viewpoint_sheet

        plot_viewpoints(out / "viewpoints.png", found)
        write_viewpoint_sheet(out / "viewpoints-sheet.png", *self.runs)
        write_flythroughs(out / "work" / "flythroughs", *self.runs, progress_of("fly-throughs"))


def laboratory(asked: Asked) -> Laboratory:
    """Where the runs of the paper's protocol are made and kept."""
    from reconstruction.bench.paper.run import Laboratory

    def recording_of(scene: str, seed: int) -> Path:
        if asked.quick:
            return recording(scene, seed, asked.work / "paper" / "quick", QUICK_TICKS, QUICK_RIG)
        return recording(scene, seed, asked.work)

    return Laboratory(asked.work / "paper", recording_of, progress_of, asked.keep)


BENCHES: dict[str, type[Bench]] = {
    "images": Images,
    "leave-out": LeaveOut,
    "paper": Paper,
    "pixels": Pixels,
    "poses": Poses,
    "rasterizer": Rasterizer,
    "recorder": Recorder,
    "training": Training,
    "viewpoints": Viewpoints,
}
