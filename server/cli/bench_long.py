"""Runs and draws the bench of long recordings. Imports are late, for a capture host has no torch."""

import sys
from functools import partial
from pathlib import Path

from acquisition.bench_document import BenchDocument
from acquisition.scenes.catalog import DEVELOPMENT_SEEDS, LONG_DEVELOPMENT
from server.cli.bench_asked import QUICK_RIG, THIS, Asked, recording

TICKS, QUICK_TICKS = 4000, 1200


def long_recordings(asked: Asked) -> BenchDocument:
    """Measure the long development scenes that were asked for."""
    from reconstruction.bench.long import FULL_S, QUICK_S, LongBench, LongClip
    from reconstruction.bench.paper.bench import timer
    from reconstruction.bench.speed_run import NEW, Contender

    seed, work = DEVELOPMENT_SEEDS[0], asked.work / "long"
    planes, rig = (QUICK_TICKS, QUICK_RIG) if asked.quick else (TICKS, None)
    named = asked.named(LONG_DEVELOPMENT[:1])
    made = {scene: partial(recording, scene, seed, work / str(planes), planes, rig) for scene in named}
    clips = [LongClip(scene, seed, planes, recorded) for scene, recorded in made.items()]
    contender, budgets_s = Contender(NEW, THIS, Path(sys.executable)), QUICK_S if asked.quick else FULL_S
    return LongBench(clips, contender, work, asked.progress_of("long"), budgets_s, time_left=timer(asked.limit_s)).run()


def draw_long(_: Asked, out: Path, found: dict) -> None:
    """Draw the picture of a document and write its page."""
    from reconstruction.bench.long_page import plot_long, write_page

    plot_long(out / "long.png", found)
    write_page(out / "long.md", found)
