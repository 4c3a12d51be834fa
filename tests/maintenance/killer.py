"""Kills parts of a running service with kill -9, and starts them again after a while; some are put to sleep instead."""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

from maintenance.deployment import Deployment

from acquisition.recording.finalise import left_planes

WORKERS = ("a", "b")
ALWAYS = ("api", "worker", "stage", "sleeper", "postgresql")
AT_CAPTURE = ("recorder", "worker_at_capture")
_MOST_AWAY_S = {"api": 1.0, "postgresql": 2.0}
_FREEZE_S = 1.0
_FINALISERS = 0.4  # share of the killed recorders whose finaliser is killed, too
_FINALISER_S = 3.0
_RIPE = 0.7  # share of the recorders that are killed with planes on the disk
_RIPENS_S = 2.0


class Killer:
    """Draws what is killed, and when it comes back, from `rng`.

    `kills` are counted by target. `kept` are the planes that a killed recorder had on the disk, by capture. `meanwhile`
    is called while the web process or the database is away.
    """

    def __init__(self, deployment: Deployment, rng: random.Random, meanwhile: Callable[[], None]) -> None:
        self._deployment = deployment
        self._rng = rng
        self._meanwhile = meanwhile
        self._due: list[tuple[float, str]] = []  # when which process is started again
        self._alarms: list[threading.Timer] = []  # that wake processes, also while a client waits for an answer
        self.kills = dict.fromkeys((*ALWAYS, *AT_CAPTURE, "finaliser"), 0)
        self.kept: dict[str, int] = {}
        self.ended_alone: list[str] = []

    @property
    def met_a_capture(self) -> bool:
        """Return whether a recorder at work, or its worker, was killed."""
        return any(self.kills[name] for name in AT_CAPTURE)

    def strike(self, *, at_capture: bool) -> None:
        """Kill something, where the thing that is drawn is there to be killed; `at_capture`: nothing else.

        Recorders live for seconds. While one is at work, every second kill is of it or of its worker, and so is the
        first.
        """
        if self._deployment.recorders():
            at_capture |= not self.met_a_capture or self._rng.random() < 0.5
        always = [name for name in ALWAYS if name != "postgresql" or self._deployment.database is not None]
        target = self._rng.choice(AT_CAPTURE if at_capture else always)
        self.kills[target] += getattr(self, f"_{target}")()

    def revive(self) -> None:
        """Start again what has been away for long enough, and what ended by itself."""
        now = time.monotonic()
        for when, name in [due for due in self._due if due[0] <= now]:
            self._due.remove((when, name))
            if name == "postgresql" and self._deployment.database is not None:
                self._deployment.database.start()
            else:
                self._deployment.start(name)
        for name in self._deployment.dead():
            self.ended_alone.append(f"{name} ended alone: {self._deployment.last_words(name)}")
            self._deployment.start(name)

    def close(self) -> None:
        """Return when nothing sleeps any more."""
        for alarm in self._alarms:
            alarm.join()

    def _api(self) -> bool:
        self._deployment.kill("api")
        self._await("api")
        return True

    def _postgresql(self) -> bool:
        assert self._deployment.database is not None
        self._deployment.database.kill()
        self._await("postgresql")
        return True

    def _worker(self) -> bool:
        return self._kill_worker(self._rng.choice(WORKERS))

    def _worker_at_capture(self) -> bool:
        found = self._recorder_at_work()
        name = None if found is None else self._deployment.worker_of(found[0])
        return name is not None and self._kill_worker(name)

    def _stage(self) -> bool:
        pids = self._deployment.stages()
        return bool(pids) and _sent(self._rng.choice(pids), signal.SIGKILL)

    def _sleeper(self) -> bool:
        """Stop a worker and its stages for longer than it takes to be declared dead."""
        name = self._rng.choice(WORKERS)
        if name not in self._deployment.processes:
            return False
        stages = [pid for pid in self._deployment.stages() if self._deployment.worker_of(pid) == name]
        pids = [pid for pid in (self._deployment.processes[name].pid, *stages) if _sent(pid, signal.SIGSTOP)]
        alarm = threading.Timer(self._rng.uniform(1.5, 3.0) * self._deployment.dead_s, _wake, [pids])
        alarm.start()
        self._alarms.append(alarm)
        return bool(pids)

    def _recorder(self) -> bool:
        """Kill a recorder; while it stands still, count what it has on the disk."""
        found = self._recorder_at_work()
        if found is None:
            return False
        pid, recording = found
        kept = left_planes(recording) if _frozen(pid) else None
        killed = _sent(pid, signal.SIGKILL)
        if killed and kept:
            self.kept[recording.name] = kept
        if killed and self._rng.random() < _FINALISERS:
            self.kills["finaliser"] += self._finaliser(recording)
        return killed

    def _recorder_at_work(self) -> tuple[int, Path] | None:
        """Return a recorder and its recording: mostly one that has planes on the disk, for which it is waited."""
        recorders = list(self._deployment.recorders().items())
        if not recorders:
            return None
        pid, recording = self._rng.choice(recorders)
        deadline = time.monotonic() + (_RIPENS_S if self._rng.random() < _RIPE else 0.0)
        while time.monotonic() < deadline and not left_planes(recording):
            time.sleep(0.05)
        time.sleep(self._rng.uniform(0.0, 0.3))
        return pid, recording

    def _finaliser(self, recording: Path) -> bool:
        """Kill what finalises a recording, as soon as it does; a service that does not within seconds is let be."""
        deadline = time.monotonic() + _FINALISER_S
        while time.monotonic() < deadline:
            pids = [pid for pid, one in self._deployment.recorders().items() if one == recording]
            if pids:
                time.sleep(self._rng.uniform(0.0, 0.3))
                return _sent(pids[0], signal.SIGKILL)
            time.sleep(0.02)
        return False

    def _kill_worker(self, name: str) -> bool:
        """Kill a worker, which stays away for up to twice the time after which it is taken for dead."""
        if name not in self._deployment.processes:
            return False
        self._deployment.kill(name)
        away_s = self._rng.choice((0.0, 0.5, 2.0)) * self._deployment.dead_s
        self._due.append((time.monotonic() + away_s, name))
        return True

    def _await(self, name: str) -> None:
        self._due.append((time.monotonic() + self._rng.uniform(0, _MOST_AWAY_S[name]), name))
        while any(due == name for _, due in self._due):
            self._meanwhile()
            time.sleep(0.1)
            self.revive()


def _sent(pid: int, number: signal.Signals) -> bool:
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return False
    return True


def _wake(pids: list[int]) -> None:
    for pid in pids:
        _sent(pid, signal.SIGCONT)


def _frozen(pid: int) -> bool:
    """Stop every thread of a process; return whether all stand still."""
    if not _sent(pid, signal.SIGSTOP):
        return False
    deadline = time.monotonic() + _FREEZE_S
    while time.monotonic() < deadline:
        try:
            stats = [(thread / "stat").read_text() for thread in Path(f"/proc/{pid}/task").iterdir()]
        except OSError:
            return False
        if all(stat.rpartition(")")[2].split()[0] == "T" for stat in stats):
            return True
        time.sleep(0.005)
    return False
