"""The document every bench prints."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from acquisition.revision import code_revision


@dataclass
class BenchDocument:
    """`rows`: one a measurement; `omissions`: what failed or was not run, and why; `summary`: named numbers.

    `scenes` is the digest of the evaluation scenes that this code has.
    """

    bench: str
    rows: list[dict] = field(default_factory=list)
    omissions: list[str] = field(default_factory=list)
    summary: dict[str, float] = field(default_factory=dict)
    scenes: str = ""

    def to_json(self) -> dict:
        """The whole document, with the machine and the code it was measured on."""
        return {
            "bench": self.bench,
            "device": {**device(), "accelerator": None},
            "revision": code_revision(),
            "scenes": self.scenes,
            "rows": self.rows,
            "omissions": self.omissions,
            "summary": {k: round(v, 6) for k, v in self.summary.items()},
        }


def device() -> dict[str, str | int]:
    """The machine: its processor's name, and the threads this process may use."""
    return {"processor": _processor(), "threads": len(os.sched_getaffinity(0))}


class Stolen:
    """How much of the processors' time the machine's other guests have taken since this was made."""

    def __init__(self, source: Path = Path("/proc/stat")) -> None:
        self._source = source
        self._before = self._times()

    def share(self) -> float:
        """Of the time of all processors, in 0..1; 0 where the system does not tell."""
        spent = [after - before for after, before in zip(self._times(), self._before, strict=True)]
        return spent[-1] / sum(spent) if any(spent) else 0.0

    def _times(self) -> list[int]:
        """Ticks of user, nice, system, idle, waiting, two kinds of interrupts, stolen."""
        try:
            return [int(word) for word in self._source.read_text().split("\n", 1)[0].split()[1:9]]
        except OSError:
            return []


def fastest_s(work: Callable[[], object], repeats: int = 7) -> float:
    """Seconds of the fastest of `repeats` calls after one that warms up: the least disturbed on a shared machine."""
    work()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return min(times)


def _processor() -> str:
    """The processor's own name, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())
