"""Measures long recordings: reconstructed in spans, beside some of their parts, each reconstructed alone.

A part alone is what the whole must not be worse than: the same planes as a recording of their own, with a minute.
Baselines take the whole in one piece, with its seconds. Every run is a process of its own, through the command line.
"""

import io
import json
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import torch

from acquisition.bench_document import SPAN, BenchDocument, device
from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from acquisition.revision import code_revision
from reconstruction.bench.conventions import in_time, kept, means
from reconstruction.bench.long.part import cut_out
from reconstruction.bench.long.seams import finished, measured_seams
from reconstruction.bench.long.spans import scored_spans
from reconstruction.bench.paper.digest import this_code
from reconstruction.bench.speed.run import SCORES, Contender, run_to_end
from reconstruction.run.spans import Span, cut
from reconstruction.training.checkpoint import load_checkpoint
from rigs.errors import Spike4dgsError

WHOLE, ALONE, BASELINE = "whole", "alone", "baseline"  # parts of the document, beside SPAN
ALONE_S, QUICK_S = 60.0, 6.0  # budget of a part alone
EVERY = 5  # spans from one that is reconstructed alone to the next
CHECKPOINT = "checkpoint.pt"
SEAMS = ("seam_ratio", "followed", "switched")  # what a row of the whole has of its seams
FLOORS = ("depth_blend.psnr_db", "depth_blend.dynamic_psnr_db")  # what any method must be better than


@dataclass(frozen=True)
class LongClip:
    """A long recording of a scene, made by `recorded` when it is first needed.

    `per_span_s`: the budget for each span that it is cut into. `baselines`: models that are given as much for all.
    """

    scene: str
    seed: int
    planes: int
    recorded: Callable[[], Path]
    per_span_s: float
    baselines: Sequence[str] = ()

    @property
    def name(self) -> str:
        """The name in rows and summaries."""
        return f"{self.scene}-{self.planes}"

    @property
    def about(self) -> dict:
        """The names that all rows of it have."""
        return {"clip": self.name, "scene": self.scene, "seed": self.seed}

    @property
    def spans(self) -> tuple[Span, ...]:
        """The spans that its reconstruction has."""
        return cut(self.planes)

    @property
    def budget_s(self) -> float:
        """The budget of the whole."""
        return self.per_span_s * len(self.spans)


@dataclass
class LongBench:
    """Measures `clips` as far as there is `time_left`; what was measured is kept in `work`, by code and machine.

    `alone_s`: the seconds of a part alone. `every`: spans from a part that is reconstructed alone to the next.
    `earlier`: rows of an earlier document; those of clips that are not measured now stay in this one.
    """

    clips: Sequence[LongClip]
    contender: Contender
    work: Path
    progress: Progress
    alone_s: float = ALONE_S
    every: int = EVERY
    time_left: Callable[[], bool] = lambda: True
    earlier: Sequence[dict] = ()

    def run(self) -> BenchDocument:
        """Return the document of all runs; what failed or was left out stands in its omissions."""
        document = BenchDocument("long")
        todo = [task for clip in self.clips for task in self._tasks(clip)]
        for number, (name, measure) in enumerate(todo):
            self.progress(number / len(todo), name)
            try:
                document.rows += kept(self.work / f"{name}.json", in_time(self.time_left, measure), self._key)["rows"]
            except Spike4dgsError as error:
                document.omissions.append(f"{name}: {error}")
        self._keep_earlier(document)
        document.summary = summarise(document.rows)
        document.omissions.append("one seed a scene, one run of each; nothing on several machines")
        self.progress(1.0, f"{len(document.rows)} rows")
        return document

    def _keep_earlier(self, document: BenchDocument) -> None:
        """Add the earlier rows of clips that were not measured now, and do not call them left out."""
        measured = {row["clip"] for row in document.rows}
        document.rows += [row for row in self.earlier if row["clip"] not in measured]
        stay = tuple(f"{clip}{end}" for clip in {row["clip"] for row in document.rows} - measured for end in "-:")
        document.omissions = [line for line in document.omissions if not line.startswith(stay)]

    @cached_property
    def _key(self) -> dict[str, str | int | float]:
        """The code, the machine and the budgets that a kept row must be of."""
        budgets = {f"{clip.name}_s": clip.budget_s for clip in self.clips}
        return device() | {"code": this_code(), "revision": code_revision(), "alone_s": self.alone_s} | budgets

    def _tasks(self, clip: LongClip) -> list[tuple[str, Callable[[], dict]]]:
        numbers = range(min(self.every // 2, len(clip.spans) - 1), len(clip.spans), self.every)
        alone = [(f"{clip.name}-{number}", partial(self._alone, clip, number)) for number in numbers]
        others = [(f"{clip.name}-{model}", partial(self._baseline, clip, model)) for model in clip.baselines]
        return [(clip.name, partial(self._whole, clip)), *alone, *others]

    def _whole(self, clip: LongClip) -> dict:
        """Return the row of the whole recording, and one for each of its spans."""
        out, budget_s = self.work / f"{clip.name}.run", clip.budget_s
        row = run_to_end(self.contender, clip.recorded(), out, budget_s, _told)
        spans = row.pop("spans", [])
        about = clip.about
        of_span = about | {"part": SPAN, "revision": row["revision"]}
        rows = [of_span | {"number": number} | span for number, span in enumerate(spans)]
        return {"rows": [about | {"part": WHOLE, "planes": clip.planes, "budget_s": budget_s} | row | device(), *rows]}

    def _alone(self, clip: LongClip, number: int) -> dict:
        """Return the row of one part of the recording, reconstructed as a recording of its own."""
        part, span = self.work / f"{clip.name}-{number}", clip.spans[number]
        if not part.exists():
            cut_out(Recording.open(clip.recorded()), span, part)
        row = run_to_end(self.contender, part, self.work / f"{clip.name}-{number}.run", self.alone_s, _told)
        about = clip.about | {"part": ALONE, "number": number, "first_tick": span.first, "last_tick": span.last - 1}
        return {"rows": [about | {"planes": len(span), "budget_s": self.alone_s} | row | device()]}

    def _baseline(self, clip: LongClip, model: str) -> dict:
        """Return the row of a baseline on the whole recording."""
        out = self.work / f"{clip.name}-{model}.run"
        row = run_to_end(self.contender, clip.recorded(), out, clip.budget_s, _told, model=model)
        about = clip.about | {"part": BASELINE, "model": model, "planes": clip.planes, "budget_s": clip.budget_s}
        return {"rows": [about | row | device()]}


def _told(run: Path) -> dict:
    """Return the bytes of the scene of a run, without its optimiser's, its floors, and of its spans and seams."""
    metrics, scene = json.loads((run / "metrics.json").read_text()), io.BytesIO()
    torch.save(load_checkpoint(run / CHECKPOINT)["cloud"], scene)
    told = {"stored_bytes": scene.tell(), "spans": metrics.get("spans", [])}
    told |= {name: metrics[name] for name in FLOORS if name in metrics}
    trained = finished(run)
    if trained is None or not told["spans"]:
        return told
    return told | measured_seams(trained) | {"spans": scored_spans(trained, told["spans"])}


def summarise(rows: Sequence[dict]) -> dict[str, float]:
    """Return how the whole of each clip compares with its parts alone.

    `CLIP.psnr_db` and the other scores are the mean over the spans that were also reconstructed alone, less that of
    these parts. `CLIP.seconds_ratio`, with the report, and `CLIP.bytes_ratio` are of a plane, `CLIP.memory_ratio` is
    of the peaks. `CLIP.seam_ratio` is of the steps of movers' errors at seams and within spans; `CLIP.followed` and
    `CLIP.switched` count bodies there. `CLIP.above_best.psnr_db` is how far the whole is above the best baseline.
    """
    summary: dict[str, float] = {}
    for whole in (row for row in rows if row["part"] == WHOLE):
        own = [row for row in rows if row["clip"] == whole["clip"]]
        parts = {_planes(row): row for row in own if row["part"] == ALONE}
        spans = [row for row in own if row["part"] == SPAN and _planes(row) in parts]
        alone = [parts[_planes(row)] for row in spans]
        if not alone:
            continue
        inside, outside = means(spans, SCORES), means(alone, SCORES)
        differences = {score: inside[score] - outside[score] for score in inside if score in outside}
        ratios = {f"{n}_ratio": _a_plane([whole], k) / _a_plane(parts.values(), k) for n, k in _A_PLANE.items()}
        ratios |= {name: whole[name] for name in SEAMS if name in whole}
        ratios["memory_ratio"] = whole["peak_mb"] / float(np.mean([row["peak_mb"] for row in parts.values()]))
        rivals = [row["psnr_db"] for row in own if row["part"] == BASELINE]
        above = {"above_best.psnr_db": whole["psnr_db"] - max(rivals)} if rivals else {}
        summary |= {f"{whole['clip']}.{name}": value for name, value in (differences | ratios | above).items()}
    return summary


def _planes(row: dict) -> tuple[int, int]:
    """Return the first and the last plane of a span, or of a part alone."""
    return row["first_tick"], row["last_tick"]


_A_PLANE = {"seconds": "wall_s", "bytes": "stored_bytes"}


def _a_plane(rows: Collection[dict], key: str) -> float:
    return sum(row[key] for row in rows) / sum(row["planes"] for row in rows)
