"""Runs the commands of either revision in processes of their own: whole reconstructions, and single steps."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from acquisition.bench_document import OLDER, Stolen
from reconstruction.bench.conventions import HOLDOUT
from reconstruction.errors import BadRunError, ReconstructionError

OLD, NEW = OLDER, "new"
SCORES = ("psnr_db", "dynamic_psnr_db", "abs_rel")
# Idle threads sleep, as where the service runs a stage: whether they spin is else up to the load at a run's start.
SLEEPING = {"OMP_WAIT_POLICY": "passive"}
FOREIGN = ("PYTHONPATH", "PYTHONHOME")  # variables that would lead an installed command to other code
ALONE = "-P"  # of Python: neither the folder of a script nor the caller's shadows what is installed
STEPPER = Path(__file__).with_name("step_times.py")  # run by the Python of either revision
LOOK_S = 0.05  # seconds between two looks at a running process
BUSY = ("-c", "while True: pass")


@dataclass(frozen=True)
class Contender:
    """A revision that is measured: the words that call its command line, and the Python that has it installed.

    `said` is what a row calls the command.
    """

    name: str
    words: tuple[str, ...]
    python: Path
    said: str = "this revision"

    @classmethod
    def installed(cls, command: Path) -> Contender:
        """Return the older revision behind an installed `spike4dgs`; raises BadRunError where its Python is not found.

        The Python is the one that the command's first line names, else the one beside the command.
        """
        first = command.read_bytes().split(b"\n", 1)[0].decode(errors="replace")
        named = re.match(r"#!\s*(\S*python[\d.]*)\s*$", first)
        python = Path(named[1]) if named else command.resolve().with_name("python")
        if not os.access(python, os.X_OK):
            found = f"found the command {command} with no Python in its first line or beside it"
            raise BadRunError(found, "a spike4dgs that pip installed", where="--against")
        return cls(OLD, (str(command.absolute()),), python, str(command))

    def environment(self) -> dict[str, str]:
        """Return the environment of this contender's processes."""
        foreign = FOREIGN if self.name == OLD else ()
        return {name: value for name, value in os.environ.items() if name not in foreign} | SLEEPING

    def revision(self) -> str:
        """Return the revision that its Python has installed; raises ReconstructionError where there is none."""
        code = "from acquisition.revision import code_revision; print(code_revision())"
        command = [self.python, ALONE, "-c", code]
        done = subprocess.run(command, capture_output=True, text=True, env=self.environment())
        if done.returncode:
            raise ReconstructionError(_last_line(done.stderr) or "found no revision", where=self.said)
        return done.stdout.strip()


def run_to_end(
    contender: Contender,
    recording: Path,
    out: Path,
    budget_s: float,
    told: Callable[[Path], dict] = lambda out: {},
    *,
    model: str = "auto",
) -> dict:
    """Reconstruct with a budget in a process of its own, and return seconds, memory and scores of its end.

    `seconds` are those from the start of the process to the last checkpoint: all but the report. `peak_mb` is the most
    memory of the process. `told` adds what else it reads in the run folder `out`, which is deleted. Raises
    ReconstructionError where the run fails.
    """
    shutil.rmtree(out, ignore_errors=True)
    options = ["--out", str(out), "--holdout", HOLDOUT, "--budget-s", f"{budget_s:g}", "--json"]
    options += [] if model == "auto" else ["--model", model]
    others, began = Stolen(), time.monotonic()
    try:
        usage = _finished([*contender.words, "reconstruct", str(recording), *options], contender)
        wall_s, stolen = time.monotonic() - began, others.share()
        run, scores = (json.loads((out / name).read_text()) for name in ("run.json", "metrics.json"))
        more = told(out)
    finally:
        shutil.rmtree(out, ignore_errors=True)
    return {
        "revision": run["revision"],
        "seconds": wall_s - run["seconds"]["report"],
        "wall_s": wall_s,
        "cpu_s": usage.cpu_s,
        "peak_mb": usage.peak_mb,
        "stolen": round(stolen, 4),
        "steps": run["steps"],
        "gaussians": sum(run["gaussians"].values()),
        **{f"seconds.{stage}": seconds for stage, seconds in run["seconds"].items()},
        **{name: scores[name] for name in SCORES if name in scores},
        **more,
    }


class Usage(NamedTuple):
    """The processor seconds that a process took, and the most memory it held, in MB."""

    cpu_s: float
    peak_mb: float


def _finished(command: Sequence[str], contender: Contender) -> Usage:
    """Run a command to its end and return what it took; raises ReconstructionError with its last line if it fails."""
    with tempfile.TemporaryFile("w+", errors="replace") as said:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=said, env=contender.environment())
        try:
            usage = _watched(process)
        except BaseException:
            _end(process)
            raise
        if process.returncode:
            said.seek(0)
            reason = _last_line(said.read()) or "it said nothing"
            raise ReconstructionError(f"found exit code {process.returncode} ({reason})", where=contender.said)
    return usage


def _watched(process: subprocess.Popen) -> Usage:
    """Wait for a process to end, and watch its memory meanwhile.

    The system's own figure for a child that has ended is no use: it begins at what the parent held.
    """
    peak_mb = 0.0
    while True:
        ended, status, took = os.wait4(process.pid, os.WNOHANG)
        if ended:
            process.returncode = os.waitstatus_to_exitcode(status)
            return Usage(took.ru_utime + took.ru_stime, peak_mb)
        peak_mb = max(peak_mb, _peak_mb(process.pid))
        time.sleep(LOOK_S)


def _peak_mb(pid: int) -> float:
    """Return the most memory that a running process has held so far, in MB; 0 where the system does not tell."""
    try:
        found = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    except OSError:
        return 0.0
    return int(found[1]) * 1024 / 1e6 if found else 0.0


class StepSize(NamedTuple):
    """The Gaussians and the picture of a step, and how many steps are timed at a turn."""

    gaussians: int
    width: int
    height: int
    repeats: int

    @property
    def label(self) -> str:
        """The name of the size in rows and summaries."""
        return f"{self.gaussians}@{self.width}x{self.height}"


class Steppers:
    """A process for each contender that times steps of training when asked, and sleeps in between.

    Enter it; each process starts when it is first asked and ends with the block.
    """

    def __init__(self) -> None:
        self._running: dict[str, subprocess.Popen[str]] = {}
        self.revisions: dict[str, str] = {}

    def __enter__(self) -> Steppers:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._running.values():
            _end(process)

    def steps(self, contender: Contender, size: StepSize, threads: int) -> list[dict[str, float]]:
        """Return the seconds of each step of a turn and its parts; raises ReconstructionError if the process ended."""
        if contender.name not in self._running:
            self._running[contender.name] = _stepper(contender)
            self.revisions[contender.name] = _answer(self._running[contender.name], contender)
        process = self._running[contender.name]
        assert process.stdin is not None
        with suppress(BrokenPipeError):  # the missing answer tells
            process.stdin.write(json.dumps(size._asdict() | {"threads": threads}) + "\n")
            process.stdin.flush()
        return _answer(process, contender)


def _stepper(contender: Contender) -> subprocess.Popen[str]:
    command = [contender.python, ALONE, STEPPER]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=contender.environment())


def _answer(process: subprocess.Popen[str], contender: Contender):
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        raise ReconstructionError("found that the process of the steps ended", "an answer", where=contender.said)
    return json.loads(line)


@contextmanager
def busy_thread() -> Iterator[None]:
    """Keep one thread of another process busy inside the block."""
    process = subprocess.Popen([sys.executable, *BUSY])
    try:
        yield
    finally:
        _end(process)


def _end(process: subprocess.Popen) -> None:
    process.kill()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(BrokenPipeError):
                pipe.close()
    process.wait()


def _last_line(text: str) -> str:
    return text.strip().rpartition("\n")[2]
