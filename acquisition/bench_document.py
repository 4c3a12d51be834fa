"""The document every bench prints."""

import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from acquisition.revision import code_revision

OLDER = "old"  # what rows of an older revision, measured beside this one, have as `which`
SPAN = "span"  # what rows of a span, which is a part of a run that has a row of its own, have as `part`


@dataclass
class BenchDocument:
    """The result of a bench: `rows`, one a measurement, and a `summary` of named numbers.

    `omissions` says what failed or was not run, and why. `refused` has runs without a result, each with its reason.
    `scenes` is the digest of this code's evaluation scenes.
    """

    bench: str
    rows: list[dict] = field(default_factory=list)
    omissions: list[str] = field(default_factory=list)
    summary: dict[str, float] = field(default_factory=dict)
    scenes: str = ""
    refused: list[dict] = field(default_factory=list)

    def to_json(self) -> dict:
        """Return the whole document, with the machine and the code it was measured on."""
        return {
            "bench": self.bench,
            "device": {**device(), "accelerator": None},
            "revision": code_revision(),
            "scenes": self.scenes,
            "rows": self.rows,
            "omissions": self.omissions,
            "refused": self.refused,
            "summary": {k: round(v, 6) for k, v in self.summary.items()},
        }


def machines_of(document: dict, rows: Sequence[dict]) -> str:
    """Name the machines that made `rows`: their own where they tell, else the document's."""
    known = {(row["processor"], row["threads"]) for row in rows if "processor" in row}
    known = known or {(document["device"]["processor"], document["device"]["threads"])}
    return "; ".join(f"{processor}, {threads} threads" for processor, threads in sorted(known))


def revisions_of(document: dict, rows: Sequence[dict]) -> str:
    """Name the revisions that made `rows`: their own where they tell, else the document's.

    Rows of an older revision, which this one is measured beside, do not count.
    """
    own = [row for row in rows if row.get("which") != OLDER]
    known = sorted({row["revision"] for row in own if "revision" in row} or {document["revision"]})
    return f"revision{'s' if len(known) > 1 else ''} {', '.join(known)}"


def device() -> dict[str, str | int]:
    """Return the processor's name and the threads that this process may use."""
    return {"processor": _processor(), "threads": len(os.sched_getaffinity(0))}


class Stolen:
    """The processors' time that other guests of the machine have taken since this object was made."""

    def __init__(self, source: Path = Path("/proc/stat")) -> None:
        self._source = source
        self._before = self._times()

    def share(self) -> float:
        """Return the share of the time of all processors, in 0..1; 0 where the system does not tell."""
        spent = [after - before for after, before in zip(self._times(), self._before, strict=True)]
        return spent[-1] / sum(spent) if any(spent) else 0.0

    def _times(self) -> list[int]:
        """Read the ticks of user, nice, system, idle, waiting, two kinds of interrupts, stolen."""
        try:
            return [int(word) for word in self._source.read_text().split("\n", 1)[0].split()[1:9]]
        except OSError:
            return []


def fastest_s(work: Callable[[], object], repeats: int = 7) -> float:
    """Time `repeats` calls after one that warms up; return the seconds of the fastest, which was disturbed least."""
    work()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return min(times)


def _processor() -> str:
    """Return the processor's own name, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())
