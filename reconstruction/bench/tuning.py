"""Searches the learning rates of ours and of each baseline that knows motion: as many trials each, on the same scenes.

Trials are drawn at random, evenly in the logarithm. The first is the method as it is.
Source: Bergstra & Bengio, "Random search for hyper-parameter optimization", JMLR 2012.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from acquisition.bench_document import BenchDocument
from acquisition.durable import write_durably
from acquisition.progress import Progress
from acquisition.scenes.catalog import DEVELOPMENT, REALISTIC
from reconstruction.bench.conventions import made_by, named
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.bench import UNPRINTED, lacks_runs, run_protocol
from reconstruction.bench.paper.method import Batch, Effort, Method, Protocol, Row, Table
from reconstruction.bench.paper.run import Laboratory
from reconstruction.bench.paper.tables import markdown
from reconstruction.methods.definition import AS_KIND, RateFactors

TRIALS, QUICK_TRIALS = 12, 2
REACH = 4.0  # factors lie from 1 / REACH to REACH
SEED = 12
METHODS = (m.AUTO, *m.TFI.values(), m.SPIKES["dy-spikegs"], m.SPIKES["dy-spikenerf"])
SCENES = (DEVELOPMENT[0], REALISTIC[-1])
LENGTH, QUICK_LENGTH = Effort(60.0), Effort(steps=20)
BETWEEN = "#"  # between the name of a method and the number of its trial
ABOUT = """Each method has the same trials: factors of its learning rates, drawn at random, evenly in the logarithm,
from 1/{reach:g} to {reach:g}. `auto` is ours. The first trial is the method as it was. The best has the highest mean
PSNR over {scenes}, which are development scenes, by the second seed of each. A best that is hardly above
the first is chance as much as gain.
Methods of which a trial was refused are not shown."""


def trials() -> tuple[RateFactors, ...]:
    """Return the factors that are tried, in their order."""
    draws = np.random.default_rng(SEED).uniform(-1, 1, (TRIALS - 1, len(AS_KIND)))
    return AS_KIND, *(RateFactors(*np.round(REACH**row, 3).tolist()) for row in draws)


def tuning_protocol(scenes: tuple[str, ...], *, quick: bool = False) -> Protocol:
    """Return the runs of the search, trial by trial, so that every method has as many at any time."""
    tried, length = (trials()[:QUICK_TRIALS], QUICK_LENGTH) if quick else (trials(), LENGTH)
    rounds = [[_tried(method, number, factors) for method in METHODS] for number, factors in enumerate(tried)]
    rows = tuple(Row(method.name, method) for one in rounds for method in one)
    batches = tuple(Batch("tuning", scenes, (length,), tuple(method.name for method in one)) for one in rounds)
    return Protocol((Table("tuning", "Learning rates", "", rows),), batches)


def bench_tuning(
    protocol: Protocol, laboratory: Laboratory, progress: Progress, time_left: Callable[[], bool]
) -> BenchDocument:
    """Run the protocol and return its rows, each with its factors, and of each method the first and the best trial."""
    document = run_protocol("tuning", protocol, laboratory, progress, time_left)
    factors = trials()
    for row in document.rows:
        row["tuned"], number = row["method"].split(BETWEEN)
        row |= {"trial": int(number), "rates": list(factors[int(number)])}
    for method in dict.fromkeys(row["tuned"] for row in document.rows):
        document.summary |= named(method, _found([r for r in document.rows if r["tuned"] == method]))
    return document


def write_page(path: Path, document: dict) -> None:
    """Write the page of a document of this bench; its table only where no run is left to be made."""
    scenes = " and ".join(dict.fromkeys(f"`{row['scene']}`" for row in document["rows"]))
    counts = {name: value for name, value in document["summary"].items() if name.endswith(".trials")}
    whole = [name.removesuffix(".trials") for name, value in counts.items() if value == max(counts.values())]
    lines = []
    for name in whole:
        own = {key.removeprefix(f"{name}."): v for key, v in document["summary"].items() if key.startswith(f"{name}.")}
        rates = (f"{own[f'best.{part}']:.2f}" for part in RateFactors._fields)
        lines.append([name, f"{own['first.psnr_db']:.2f}", f"{own['best.psnr_db']:.2f}", *rates])
    about = ABOUT.format(reach=REACH, scenes=scenes)
    columns = ("method", "first / dB", "best / dB", "still", "moving", "motion")
    table = UNPRINTED if lacks_runs(document["omissions"]) else markdown(columns, lines)
    write_durably(path, f"# Learning rates\n\n{made_by(document)}\n\n{about}\n\n{table}\n".encode())


def _tried(method: Method, number: int, factors: RateFactors) -> Method:
    return replace(method, name=f"{method.name}{BETWEEN}{number}", choices=method.choices | {"rates": factors})


def _found(rows: list[dict]) -> dict[str, float]:
    """Return the first and the best trial of a method, of those that all of its scenes have."""
    scenes = {row["scene"] for row in rows}
    own = {n: [r for r in rows if r["trial"] == n] for n in dict.fromkeys(row["trial"] for row in rows)}
    levels = {n: float(np.mean([r["psnr_db"] for r in runs])) for n, runs in own.items() if len(runs) == len(scenes)}
    best = max(levels, key=levels.__getitem__)
    rates = {f"best.{part}": factor for part, factor in zip(RateFactors._fields, own[best][0]["rates"], strict=True)}
    return {"trials": len(levels), "first.psnr_db": levels.get(0, np.nan), "best.psnr_db": levels[best], **rates}
