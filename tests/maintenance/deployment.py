"""A whole service on this machine: the web process, workers and, where asked, a PostgreSQL of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from maintenance.ports import free_port
from maintenance.postgresql import Postgresql

from server.store.files import is_locked

STAGE = (sys.executable, "-I", "-S", str(Path(__file__).with_name("stand_in_stage.py")))
RECORDER = (sys.executable, "-P", "-m", "server.cli")  # what `stand_in_stage` becomes for a real recording


class Deployment:
    """Processes by name (`api`, and workers by their own), each started, killed and started again at will.

    `stage` is the command of every stage: one that sleeps unless told otherwise.
    """

    def __init__(
        self,
        data: Path,
        *,
        postgresql: bool,
        dead_s: float = 5.0,
        step_s: float = 0.05,
        stage: Sequence[str] = STAGE,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.data = data
        self.dead_s = dead_s
        data.mkdir(parents=True, exist_ok=True)
        self.database = Postgresql() if postgresql else None
        self.port = free_port()
        self.address = f"http://127.0.0.1:{self.port}"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._environment = os.environ | {
            "SPIKE4DGS_STAGE_COMMAND": json.dumps(stage),
            "SPIKE4DGS_DEAD_S": str(dead_s),
            "BENCH_STEP_S": str(step_s),
            **(environment or {}),
        }
        if self.database is not None:
            self._environment |= self.database.environment

    def start(self, name: str, late_s: float = 0.0, environment: Mapping[str, str] | None = None) -> None:
        """Start the web process, `api`, or a worker: with more variables, and with a clock that is `late_s` behind."""
        command = ["serve", "--port", str(self.port)] if name == "api" else ["worker", "--name", name]
        with (self.data / f"{name}.log").open("ab") as log:
            self.processes[name] = subprocess.Popen(
                [sys.executable, "-P", *_program(late_s), *command, "--data", str(self.data)],
                env=self._environment | dict(environment or {}),
                stdout=log,
                stderr=log,
            )

    def kill(self, name: str) -> None:
        """kill -9."""
        self.processes[name].kill()
        self.processes.pop(name).wait()

    def dead(self) -> list[str]:
        """Those that ended by themselves, which none should."""
        return [name for name, process in self.processes.items() if process.poll() is not None]

    def last_words(self, name: str) -> str:
        """Describe how a process ended, with the last line of its log."""
        lines = (self.data / f"{name}.log").read_text(errors="replace").splitlines()
        return f"exit {self.processes[name].poll()}, {lines[-1] if lines else 'no log'}"

    def stages(self) -> list[int]:
        """Process ids of the stages that run now."""
        return [pid for pid in self.family() if _command(pid)[:4] == list(STAGE)]

    def recorders(self) -> dict[int, Path]:
        """Process ids of the real recorders that record or finalise now, and the recording of each."""
        commands = {pid: _command(pid) for pid in self.family()}
        at_work = {pid: command[4:] for pid, command in commands.items() if command[:4] == list(RECORDER)}
        return {
            pid: Path(rest[rest.index("--out") + 1] if rest[0] == "record" else rest[1])
            for pid, rest in at_work.items()
            if rest[0] in ("record", "finalise")
        }

    def worker_of(self, pid: int) -> str | None:
        """The worker that started a stage, if it is still alive."""
        parent = ancestors(pid)[:1]
        return next((name for name, process in self.processes.items() if [process.pid] == parent), None)

    def family(self) -> list[int]:
        """Process ids of all that name the data folder, but this one."""
        pids = [int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()]
        return [p for p in pids if p != os.getpid() and any(str(self.data) in word for word in _command(p))]

    def stop(self) -> None:
        """End all but the database in order."""
        for process in self.processes.values():
            process.terminate()
        for process in self.processes.values():
            try:
                process.wait(60)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.processes.clear()

    def close(self) -> None:
        """End everything, and whatever was left behind."""
        self.stop()
        for pid in self.family():
            os.kill(pid, signal.SIGKILL)
        if self.database is not None:
            self.database.close()

    def locked(self) -> list[str]:
        """Folders whose flock somebody holds."""
        kinds = ("entries/*", "entries/*/parts", "rigs/*", "workers/*")
        folders = [path for kind in kinds for path in self.data.glob(kind)]
        return [str(folder) for folder in folders if is_locked(folder)]


def _program(late_s: float) -> list[str]:
    late = f"import time; now = time.time; time.time = lambda: now() - {late_s}"
    return ["-c", f"{late}; from server.cli.main import main; main()"] if late_s else ["-m", "server.cli"]


def _command(pid: int) -> list[str]:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return []


def ancestors(pid: int) -> list[int]:
    """Return the process ids above a process, its parent's first, as far as they can be read."""
    above: list[int] = []
    while pid > 1:
        try:
            pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            break
        above.append(pid)
    return above
