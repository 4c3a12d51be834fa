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
    from reconstruction.bench.conventions import KnownRecording
    from reconstruction.bench.speed.bench import Clip, Ended, Extent
    from reconstruction.bench.speed.run import Contender

LARGE_SEEDS = DEVELOPMENT_SEEDS[:2]


def speed(asked: Asked) -> BenchDocument:
    """Measure whole runs and single steps of this revision, and of an older one in turns."""
    from reconstruction.bench.paper.bench import timer
    from reconstruction.bench.speed.bench import SpeedBench

    extent, clips = _clips(asked)
    progress, seen, contenders = asked.progress_of("speed"), partial(_keep_movers, asked), _contenders(asked)
    return SpeedBench(contenders, clips, _work(asked), progress, extent, timer(asked.limit_s), seen=seen).run()


def large(asked: Asked) -> BenchDocument:
    """Measure whole runs at a million pixels: of both revisions on the first seed, of this one on another."""
    from reconstruction.bench.paper.bench import timer
    from reconstruction.bench.speed.bench import LARGE, LARGE_AGAIN, LARGE_QUICK, LARGE_SIZE, Clip, SpeedBench

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


def draw_speed(asked: Asked, out: Path, found: dict) -> None:
    """Draw the picture of a document of speed, its page, and movers of both revisions after as many seconds."""
    from reconstruction.bench.speed.mover_sheet import write_mover_sheet
    from reconstruction.bench.speed.run import NEW, OLD

    _draw(out, found)
    budget_s, clips = _shown_s(asked), _clips(asked)[1]
    measured = {(row["clip"], row["which"]) for row in found["rows"] if row.get("budget_s") == budget_s}
    shown = [
        (_known(clip), {f"{name} after {budget_s:g} s": _image(asked, clip, name) for name in (OLD, NEW)})
        for clip in clips
        if (clip.name, NEW) in measured
    ]
    if shown:
        write_mover_sheet(out / "speed-movers.jpg", shown)


def draw_large(asked: Asked, out: Path, found: dict) -> None:
    """Do the same of large pictures, with a sheet of whole views."""
    from reconstruction.bench.contact_sheet import stack_sheets

    _draw(out, found)
    if sheets := sorted(_tiles(asked).glob("*.png")):
        stack_sheets(out / "large-sheet.jpg", sheets)


def _draw(out: Path, found: dict) -> None:
    """Draw the picture of a document of either bench, and write its page."""
    from reconstruction.bench.diagrams import PLOTS
    from reconstruction.bench.speed.page import write_page

    name = found["bench"]
    PLOTS[name](out / f"{name}.png", found)
    write_page(out / f"{name}.md", found)


def _clips(asked: Asked) -> tuple[Extent, list[Clip]]:
    """Return what the bench of speed measures, and the recordings it measures on."""
    from reconstruction.bench.speed.bench import FULL, QUICK, Clip

    extent, rig = (QUICK, QUICK_RIG) if asked.quick else (FULL, None)
    ticks, place = (QUICK_TICKS, _work(asked)) if asked.quick else (TICKS, asked.work)
    seed = DEVELOPMENT_SEEDS[0]
    scenes = asked.named((*DEVELOPMENT, *REALISTIC))
    return extent, [Clip(one, seed, extent.runs, partial(recording, one, seed, place, ticks, rig)) for one in scenes]


def _work(asked: Asked) -> Path:
    return asked.work / ("speed/quick" if asked.quick else "speed")


def _known(clip: Clip) -> KnownRecording:
    from reconstruction.bench.conventions import KnownRecording

    return KnownRecording(clip.scene, clip.seed, clip.recorded())


def _shown_s(asked: Asked) -> float:
    """Return the seconds of the runs on the sheet of movers: the longest that both revisions have."""
    from reconstruction.bench.speed.run import OLD

    return max(budget_s for name, budget_s in _clips(asked)[0].runs if name == OLD)


def _image(asked: Asked, clip: Clip, name: str) -> Path:
    return _work(asked) / "movers" / f"{clip.name}-{name}.npy"


def _keep_movers(asked: Asked, ended: Ended) -> None:
    """Keep the held-out view of a run that the sheet of movers shows."""
    from reconstruction.bench.speed.mover_sheet import shoot

    if ended.budget_s == _shown_s(asked):
        image = _image(asked, ended.clip, ended.contender.name)
        shoot(ended.contender, _known(ended.clip), ended.folder, image)


def _contenders(asked: Asked) -> list[Contender]:
    """Return this revision, behind the older one where its command was given."""
    from reconstruction.bench.speed.run import NEW, Contender

    this = Contender(NEW, THIS, Path(sys.executable))
    return [Contender.installed(asked.against), this] if asked.against else [this]


def _tiles(asked: Asked) -> Path:
    return asked.work / "large" / "tiles"


def _keep_tiles(asked: Asked, ended: Ended) -> None:
    """Keep the pictures of a run of this revision that ended: those of the longest budget come last, and stay."""
    from reconstruction.bench.contact_sheet import run_tiles, write_sheet
    from reconstruction.bench.speed.run import NEW
    from reconstruction.run.folder import RunFolder

    if ended.contender.name != NEW:
        return
    tiles = run_tiles(_known(ended.clip), RunFolder.open(ended.folder))
    _tiles(asked).mkdir(parents=True, exist_ok=True)
    write_sheet(_tiles(asked) / f"{ended.clip.name}.png", [tiles[:3], tiles[3:]])
