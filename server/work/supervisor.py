"""Runs one stage as one process: locked, leashed, reporting, and stopped when the stage is cancelled."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import json
import os
import signal
from asyncio.subprocess import DEVNULL, PIPE
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from acquisition.progress import Progress
from server.errors import ServiceError
from server.work.leash import leashed

_LOCK_POLL_S = 0.1
_CONTROL_POLL_S = 0.05
_START_S = 10.0  # until a process that says nothing is taken to be able to end in order
_LONGEST_LINE = 65536
_LAST_WORDS_S = 1.0


class StageError(ServiceError):
    """A stage ended badly; the message is the last line it wrote."""


@dataclass(frozen=True)
class Control:
    """Files by which a running stage is told something: `stop` becomes SIGTERM, `save` a line on standard input."""

    stop: Path
    save: Path


async def supervise(
    command: Sequence[str],
    *,
    folders: Sequence[Path],
    log: Path,
    on_progress: Progress,
    grace_s: float,
    control: Control | None = None,
    stdout: Path | None = None,
    answers: bool = False,
    environment: Mapping[str, str] | None = None,
    finished: Path | None = None,
    is_due: Callable[[], bool] = lambda: True,
) -> None:
    """Run `command` while holding the flock of every one of `folders`; raises StageError when it fails.

    `finished` is the mark of its success, which the command leaves itself where it can, so that nobody's death comes
    between its end and the mark. Where it is there, or the work is not `is_due`, nothing is done.

    The process inherits the locks, so they last until it is gone even where this process dies first. Cancelling sends
    SIGTERM to its session and SIGKILL after `grace_s`, and returns when it is gone. What it prints goes to `log`, or to
    `stdout`. Where it `answers`, an exit code of 1 with an answer is no failure.
    """
    async with _locked(folders) as locks:
        if (finished is not None and finished.exists()) or not is_due():
            return
        mark = {} if finished is None else {"SPIKE4DGS_FINISHED": str(finished)}
        with log.open("a") as text, stdout.open("w") if stdout else contextlib.nullcontext(text) as printed:
            relay = _Relay(text, on_progress)
            transport, _ = await asyncio.get_running_loop().subprocess_exec(
                lambda: relay,
                *leashed(list(command), "SIGKILL"),
                stdin=PIPE if control else DEVNULL,
                stdout=printed,
                stderr=PIPE,
                env=os.environ | {"SPIKE4DGS_PROGRESS": "json"} | mark | dict(environment or {}),
                start_new_session=True,
                pass_fds=locks,
            )
            teller = asyncio.ensure_future(_tell(transport, relay, control)) if control else None
            try:
                await relay.over.wait()
            finally:
                if teller:
                    teller.cancel()
                await _insist(_stop(transport, relay, grace_s))
                transport.close()
        if relay.fault is not None:
            raise relay.fault
        _judge(transport.get_returncode() or 0, relay, stdout if answers else None)
        if finished is not None:
            finished.touch()


def _judge(code: int, relay: _Relay, answer: Path | None) -> None:
    if code == 1 and answer and answer.stat().st_size:
        return
    if code != 0:
        ended = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        raise StageError(relay.last.removeprefix("spike4dgs: ") or f"the stage ended with {ended} and no message")


async def _tell(transport: asyncio.SubprocessTransport, relay: _Relay, control: Control) -> None:
    """Pass on what the files say, each once; SIGTERM would kill a process that has not reported anything yet."""
    line = transport.get_pipe_transport(0)
    assert isinstance(line, asyncio.WriteTransport)
    clock = asyncio.get_running_loop().time
    patient_until = clock() + _START_S
    saved = False
    while True:
        if control.save.exists() and not saved:
            saved = True
            line.write(b"\n")
        if control.stop.exists() and (relay.began or clock() > patient_until):
            os.killpg(transport.get_pid(), signal.SIGTERM)
            return
        await asyncio.sleep(_CONTROL_POLL_S)


@contextlib.asynccontextmanager
async def _locked(folders: Sequence[Path]) -> AsyncIterator[list[int]]:
    descriptors: list[int] = []
    try:
        for folder in folders:
            descriptors.append(os.open(folder, os.O_RDONLY))
            while True:
                try:
                    fcntl.flock(descriptors[-1], fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    await asyncio.sleep(_LOCK_POLL_S)
        yield descriptors
    finally:
        for descriptor in descriptors:
            os.close(descriptor)


class _Relay(asyncio.SubprocessProtocol):
    """Takes the process's standard error apart, to its very end: callbacks go on where a cancelled task would not.

    `gone` is set when the process is, `closed` at the end of its output, `over` when it is gone or a fault of ours,
    such as a full disk, leaves no reason to wait for it; `began` says that it has reported progress.
    """

    def __init__(self, log: TextIO, on_progress: Progress) -> None:
        self.gone, self.closed, self.over = asyncio.Event(), asyncio.Event(), asyncio.Event()
        self.began = False
        self.last = ""
        self.fault: OSError | None = None
        self._log = log
        self._on_progress = on_progress
        self._pending = b""

    def pipe_data_received(self, fd: int, data: bytes) -> None:
        """Pass whole lines on; one longer than 64 KiB goes in pieces."""
        *whole, self._pending = (self._pending + data).split(b"\n")
        if len(self._pending) > _LONGEST_LINE:
            whole.append(self._pending)
            self._pending = b""
        for line in whole:
            self._pass_on(line.decode(errors="replace"))

    def process_exited(self) -> None:
        """The process is gone; what it wrote may still be on its way."""
        self.gone.set()
        self.over.set()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing more will come."""
        if self._pending:
            self._pass_on(self._pending.decode(errors="replace"))
        self.closed.set()

    def _pass_on(self, line: str) -> None:
        try:
            if _reported(line, self._on_progress):
                self.began = True
                return
            self._log.write(f"{line}\n")
            self._log.flush()
            self.last = line.strip() or self.last
        except OSError as error:
            self.fault = self.fault or error
            self.over.set()


def _reported(line: str, on_progress: Progress) -> bool:
    if not line.startswith("{"):
        return False
    try:
        event = json.loads(line)
        if event["event"] != "progress":
            return False
        on_progress(min(max(0.0, float(event["fraction"])), 1.0), str(event["message"]))
    except (ValueError, KeyError, TypeError):
        return False
    return True


async def _stop(transport: asyncio.SubprocessTransport, relay: _Relay, grace_s: float) -> None:
    for number, patience_s in ((signal.SIGTERM, grace_s), (signal.SIGKILL, None)):
        if relay.gone.is_set():
            break
        with contextlib.suppress(ProcessLookupError):
            os.killpg(transport.get_pid(), number)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(relay.gone.wait(), patience_s)
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(relay.closed.wait(), _LAST_WORDS_S)


async def _insist(work: Coroutine[None, None, None]) -> None:
    """Finish `work` however often the caller is cancelled meanwhile: a closing event loop cancels more than once."""
    task = asyncio.ensure_future(work)
    while not task.done():
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.shield(task)
    task.result()
