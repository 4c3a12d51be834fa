"""Measures how much sooner this revision has what an older one had: both in turns on one machine.

The older revision is an installed command. A run is a process of its own through the command line, and a point is
always the end of a run with that budget. Single steps of training are timed by size and threads, and beside a busy
process.
"""

import os
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple

from acquisition.bench_document import BenchDocument, Stolen, device
from acquisition.progress import Progress, part
from acquisition.revision import code_revision
from reconstruction.bench.conventions import in_time, kept
from reconstruction.bench.paper.digest import this_code
from reconstruction.bench.paper.run import QUIET, TRIES
from reconstruction.bench.speed.run import NEW, OLD, Contender, Steppers, StepSize, busy_thread, run_to_end
from reconstruction.bench.speed.step_times import WHOLE
from reconstruction.bench.speed.summary import LOADED, PART, STEPS, summarise
from rigs.errors import Spike4dgsError

TURNS = 7  # times that each contender steps
STEPS_SHARE = 0.1  # share of the bench that times single steps


@dataclass(frozen=True)
class Extent:
    """The amount that is measured: runs as contenders and budgets in seconds, in turns; sizes of steps; turns of each.

    `loaded`: the size of the steps beside a busy process; None for none.
    """

    runs: tuple[tuple[str, float], ...]
    steps: tuple[StepSize, ...] = ()
    loaded: StepSize | None = None
    turns: int = TURNS


PLAIN, LARGE_STEP = StepSize(48_000, 400, 250, 10), StepSize(96_000, 1000, 1000, 3)
FULL = Extent(
    ((OLD, 60.0), (NEW, 20.0), (NEW, 60.0), (OLD, 40.0), (NEW, 40.0), (OLD, 20.0), (NEW, 10.0), (NEW, 300.0)),
    (StepSize(20_000, 400, 250, 15), PLAIN, LARGE_STEP),
    PLAIN,
)
_TINY = StepSize(2_000, 200, 125, 5)
QUICK = Extent(((OLD, 6.0), (NEW, 3.0), (NEW, 6.0)), (_TINY,), _TINY, 2)
LARGE = Extent(((OLD, 180.0), (NEW, 180.0), (OLD, 600.0), (NEW, 600.0)))
LARGE_QUICK = Extent(((NEW, 20.0),))
LARGE_AGAIN = ((NEW, 180.0), (NEW, 600.0))  # runs of seeds after the first
LARGE_SIZE = (1000, 1000)


@dataclass(frozen=True)
class Clip:
    """A recording of a scene with a seed, made by `recorded` when it is first needed, and its runs in turns."""

    scene: str
    seed: int
    runs: tuple[tuple[str, float], ...]
    recorded: Callable[[], Path]
    size: tuple[int, int] | None = None

    @property
    def name(self) -> str:
        """The name in rows and summaries; a clip of another size than the rig's says so, and its seed."""
        return f"{self.scene}-{self.seed}-{self.size[0]}x{self.size[1]}" if self.size else self.scene


class Ended(NamedTuple):
    """A run that ended: its recording, who made it in how many seconds, and its folder."""

    clip: Clip
    contender: Contender
    budget_s: float
    folder: Path


@dataclass
class SpeedBench:
    """Measures `contenders` on `clips`, as far as there is `time_left`; what was measured is kept in `work`.

    What an earlier call has measured with the same revisions on the same machine is not measured again. `name` is the
    document's. `seen` is called with each run that ended, before its folder is deleted.
    """

    contenders: Sequence[Contender]
    clips: Sequence[Clip]
    work: Path
    progress: Progress
    extent: Extent = FULL
    time_left: Callable[[], bool] = lambda: True
    name: str = "speed"
    seen: Callable[[Ended], None] = lambda ended: None

    def run(self) -> BenchDocument:
        """Return the document of all runs and steps; what failed or was left out stands in its omissions."""
        document = BenchDocument(self.name)
        self.work.mkdir(parents=True, exist_ok=True)
        with Steppers() as steppers:
            self._measure(document, self._steps(steppers), part(self.progress, 0.0, STEPS_SHARE))
        self._measure(document, self._ends(), part(self.progress, STEPS_SHARE, 1.0))
        document.summary = summarise(document.rows)
        if all(contender.name != OLD for contender in self.contenders):
            document.omissions.append("the older revision: no command of it was given with --against")
        document.omissions.append("one run a budget; a second one where others took a tenth of it")
        self.progress(1.0, f"{len(document.rows)} rows")
        return document

    @cached_property
    def _key(self) -> dict[str, str | int]:
        """The code and the machine that a kept row must be of."""
        key = device() | {"code": this_code(), "revision": code_revision()}
        return key | {c.said: c.revision() for c in self.contenders if c.name == OLD}

    def _measure(
        self, document: BenchDocument, todo: Sequence[tuple[str, Callable[[], dict]]], progress: Progress
    ) -> None:
        """Add the rows of all measurements, each a name and what makes it, and say which were left out and why."""
        for number, (name, measure) in enumerate(todo):
            progress(number / len(todo), name)
            try:
                document.rows += kept(self.work / f"{name}.json", in_time(self.time_left, measure), self._key)["rows"]
            except Spike4dgsError as error:
                document.omissions.append(f"{name}: {error}")

    def _steps(self, steppers: Steppers) -> list[tuple[str, Callable[[], dict]]]:
        """Return the measurements of steps by their names: each size on one and on all threads, and beside a load."""
        most = len(os.sched_getaffinity(0))
        parts = [(STEPS, size, threads) for size in self.extent.steps for threads in sorted({1, most})]
        if self.extent.loaded:
            parts.append((LOADED, self.extent.loaded, most))
        return [
            (f"{kind}-{size.label}-{threads}", partial(self._in_turns, steppers, kind, size, threads))
            for kind, size, threads in parts
        ]

    def _in_turns(self, steppers: Steppers, kind: str, size: StepSize, threads: int) -> dict:
        """Return a row for each contender, or one beside a busy process and one without; all of them step in turns."""
        loads = (False, True) if kind == LOADED else (False,)
        taken: dict[tuple[Contender, bool], list[dict]] = {(c, load): [] for load in loads for c in self.contenders}
        others = Stolen()
        for _ in range(self.extent.turns):
            for load in loads:
                with busy_thread() if load else nullcontext():
                    for contender in self.contenders:
                        taken[contender, load] += steppers.steps(contender, size, threads)
        about = {"part": kind, "size": size.label, "threads": threads, "stolen": round(others.share(), 4)}
        return {
            "rows": [
                about
                | {"which": c.name, "command": c.said, "revision": steppers.revisions[c.name], "loaded": load}
                | _of_steps(steps)
                for (c, load), steps in taken.items()
            ]
        }

    def _ends(self) -> list[tuple[str, Callable[[], dict]]]:
        """Return the measurements of whole runs by their names, clip by clip in turns."""
        known = {contender.name: contender for contender in self.contenders}
        return [
            (f"{clip.name}-{which}@{budget_s:g}", partial(self._end, clip, known[which], budget_s))
            for clip in self.clips
            for which, budget_s in clip.runs
            if which in known
        ]

    def _end(self, clip: Clip, contender: Contender, budget_s: float) -> dict:
        """Return the row of a run; one that others disturbed is repeated, and the quietest counts."""
        recording, tried = clip.recorded(), []
        while not tried or (len(tried) < TRIES and tried[-1]["stolen"] > QUIET):
            out = self.work / f"{clip.name}-{contender.name}.run"
            shown = partial(self._shown, clip, contender, budget_s)
            tried.append(run_to_end(contender, recording, out, budget_s, shown))
        about = {"part": "ends", "which": contender.name, "command": contender.said, "clip": clip.name}
        about |= {"scene": clip.scene, "seed": clip.seed, "budget_s": budget_s}
        return {"rows": [about | min(tried, key=lambda row: row["stolen"])]}

    def _shown(self, clip: Clip, contender: Contender, budget_s: float, out: Path) -> dict:
        """Show a run that ended, and tell nothing more of it."""
        self.seen(Ended(clip, contender, budget_s, out))
        return {}


def _of_steps(steps: Sequence[dict[str, float]]) -> dict[str, float]:
    """Return the least and the median seconds of whole steps, and the least of each of their parts."""
    seconds = sorted(step[WHOLE] for step in steps)
    parts = {f"{PART}{name}": min(step[name] for step in steps) for name in steps[0] if name != WHOLE}
    return {"seconds": seconds[0], "median_s": seconds[len(seconds) // 2], "steps": len(steps), **parts}
