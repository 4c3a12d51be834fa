"""Runs and draws the bench of long recordings. Imports are late, for a capture host has no torch."""

import sys
from functools import partial
from pathlib import Path

from acquisition.bench_document import BenchDocument
from acquisition.scenes.catalog import (
    DEVELOPMENT_SEEDS,
    EVALUATION_SEEDS,
    LONG_DEVELOPMENT,
    LONG_EVALUATION,
    REALISTIC_LONG,
)
from acquisition.scenes.looks import EVALUATED
from server.cli.bench_asked import QUICK_RIG, THIS, Asked, recording

SPAN_S = {4000: 18.0, 20_000: 12.0}  # seconds for each span, by the planes of a recording
QUICK_SPAN_S = {1200: 3.0}
SCENES = (LONG_DEVELOPMENT[0], *LONG_EVALUATION, *REALISTIC_LONG)
MOST = 5000  # planes of all but the development scenes: a path tracer draws no more, and each has as many runs
WITH_BASELINES = (4000,)  # planes of a recording that baselines reconstruct, too


def long_recordings(asked: Asked) -> BenchDocument:
    """Measure the long scenes that were asked for; an earlier document's runs on others are kept."""
    from reconstruction.bench.long.bench import ALONE_S, QUICK_S, LongBench, LongClip
    from reconstruction.bench.paper.bench import timer
    from reconstruction.bench.speed.run import NEW, Contender
    from reconstruction.methods.catalogue import METHODS

    work = asked.work / "long"
    rivals = [
        name for name, method in METHODS.items() if not method.ours and method.moves and method.supervision == "pixels"
    ]
    rig, span_s = (QUICK_RIG, QUICK_SPAN_S) if asked.quick else (None, SPAN_S)
    clips = []
    for planes, per_span_s in span_s.items():
        for scene in asked.named(SCENES):
            if scene not in LONG_DEVELOPMENT and planes > MOST:
                continue
            seed = (EVALUATION_SEEDS if scene in EVALUATED else DEVELOPMENT_SEEDS)[0]
            recorded = partial(recording, scene, seed, work / str(planes), planes, rig)
            clips.append(
                LongClip(scene, seed, planes, recorded, per_span_s, rivals if planes in WITH_BASELINES else ())
            )
    contender, alone_s = Contender(NEW, THIS, Path(sys.executable)), QUICK_S if asked.quick else ALONE_S
    bench = LongBench(clips, contender, work, asked.progress_of("long"), alone_s, time_left=timer(asked.limit_s))
    bench.earlier = asked.earlier_document().get("rows", [])
    return bench.run()


def draw_long(_: Asked, out: Path, found: dict) -> None:
    """Draw the picture of a document and write its page."""
    from reconstruction.bench.long.page import plot_long, write_page

    plot_long(out / "long.png", found)
    write_page(out / "long.md", found)
