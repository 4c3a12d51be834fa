"""Runs and draws the benches of speed. Imports are late, for a capture host has no torch."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.bench_document import BenchDocument
from acquisition.scenes.catalog import DEVELOPMENT, DEVELOPMENT_SEEDS, REALISTIC
from server.cli.bench_asked import QUICK_RIG, QUICK_TICKS, THIS, TICKS, Asked, recording

if TYPE_CHECKING:
    from reconstruction.bench.speed import Clip
    from reconstruction.bench.speed_run import Contender

LARGE_SEEDS = DEVELOPMENT_SEEDS[:2]


def speed(asked: Asked) -> BenchDocument:
    """Measure whole runs and single steps of this revision, and of an older one in turns."""
    from reconstruction.bench.paper.bench import timer
    from reconstruction.bench.speed import FULL, QUICK, Clip, SpeedBench

    extent, work, rig = (QUICK, "speed/quick", QUICK_RIG) if asked.quick else (FULL, "speed", None)
    ticks, place = (QUICK_TICKS, asked.work / work) if asked.quick else (TICKS, asked.work)
    seed = DEVELOPMENT_SEEDS[0]
    clips = [
        Clip(scene, seed, extent.runs, partial(recording, scene, seed, place, ticks, rig))
        for scene in asked.named((*DEVELOPMENT, *REALISTIC))
    ]
    progress = asked.progress_of("speed")
    return SpeedBench(_contenders(asked), clips, asked.work / work, progress, extent, timer(asked.limit_s)).run()


def large(asked: Asked) -> BenchDocument:
    """Measure whole runs at a million pixels: of both revisions on the first seed, of this one on another."""
    from reconstruction.bench.paper.bench import timer
    from reconstruction.bench.speed import LARGE, LARGE_AGAIN, LARGE_QUICK, LARGE_SIZE, Clip, SpeedBench

    size, work = "x".join(map(str, LARGE_SIZE)), asked.work / "large"
    extent, ticks = (LARGE_QUICK, QUICK_TICKS) if asked.quick else (LARGE, TICKS)
    clips = []
    for scene in asked.named(DEVELOPMENT):
        for seed in LARGE_SEEDS[:1] if asked.quick else LARGE_SEEDS:
            recorded = partial(recording, scene, seed, work / str(ticks), ticks, size=size)
            runs = extent.runs if seed == LARGE_SEEDS[0] else LARGE_AGAIN
            clips.append(Clip(scene, seed, runs, recorded, LARGE_SIZE))
    progress, seen = asked.progress_of("large"), partial(_keep_tiles, asked)
    measured = SpeedBench(_contenders(asked), clips, work, progress, extent, timer(asked.limit_s), "large", seen)
    return measured.run()


def draw_speed(_: Asked, out: Path, found: dict) -> None:
    """Draw the picture of a document of either bench, and write its page."""
    from reconstruction.bench.diagrams import PLOTS
    from reconstruction.bench.speed_page import write_page

    name = found["bench"]
    PLOTS[name](out / f"{name}.png", found)
    write_page(out / f"{name}.md", found)


def draw_large(asked: Asked, out: Path, found: dict) -> None:
    """Do the same of the bench of large pictures, and write a sheet of its ends."""
    from reconstruction.bench.contact_sheet import stack_sheets

    draw_speed(asked, out, found)
    if sheets := sorted(_tiles(asked).glob("*.png")):
        stack_sheets(out / "large-sheet.jpg", sheets)


def _contenders(asked: Asked) -> list[Contender]:
    """Return this revision, behind the older one where its command was given."""
    from reconstruction.bench.speed_run import NEW, Contender

    this = Contender(NEW, THIS, Path(sys.executable))
    return [Contender.installed(asked.against), this] if asked.against else [this]


def _tiles(asked: Asked) -> Path:
    return asked.work / "large" / "tiles"


def _keep_tiles(asked: Asked, clip: Clip, out: Path) -> None:
    """Keep the pictures of a run that ended: those of the longest budget come last, and stay."""
    from reconstruction.bench.contact_sheet import run_tiles, write_sheet
    from reconstruction.bench.conventions import KnownRecording
    from reconstruction.run.folder import RunFolder

    tiles = run_tiles(KnownRecording(clip.scene, clip.seed, clip.recorded()), RunFolder.open(out))
    _tiles(asked).mkdir(parents=True, exist_ok=True)
    write_sheet(_tiles(asked) / f"{clip.name}.png", [tiles[:3], tiles[3:]])
