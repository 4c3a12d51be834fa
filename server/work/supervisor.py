"""Runs one stage as one process: locked, leashed, reporting, and stopped when the stage is cancelled."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
from asyncio.subprocess import DEVNULL, PIPE
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TextIO, cast

from acquisition.errors import DiskError, StoppedError
from acquisition.progress import Progress
from server.errors import ServiceError
from server.store.files import locked, shared
from server.work.forks import Fork, fork
from server.work.leash import leashed, named_end

_LOCK_POLL_S = 0.1
_CONTROL_POLL_S = 0.05
_START_S = 10.0  # after which a process that reported nothing is taken to be able to end in order
_LONGEST_LINE = 65536  # bytes
_LAST_WORDS_S = 1.0
_REFUSED = 2  # exit code of a command that cannot use what it was given


class StageError(ServiceError):
    """A stage ended badly: the error that its process reported or, where it reported none, the last line it wrote."""


class BadInputError(StageError):
    """A stage refused what was asked for or recorded: it would do so again."""

    bad_input = True


class KilledError(StageError):
    """A stage's process was killed by the signal `number` before it could end in order."""

    def __init__(self, found: str, number: int) -> None:
        super().__init__(found)
        self.number = number


class NoRoomStageError(StageError):
    """A stage could not write what it made: the fault is the disk's."""


class StoppedStageError(StageError):
    """A stage was stopped by an order before it had made anything to keep."""


_BY_NAME = {StoppedError.__name__: StoppedStageError, DiskError.__name__: NoRoomStageError}


@dataclass(frozen=True)
class Control:
    """Files that give orders to a running stage: `stop` becomes SIGTERM, `save` a line on standard input."""

    stop: Path
    save: Path


async def supervise(
    command: Sequence[str],
    *,
    folders: Sequence[Path],
    beside: Path | None = None,
    log: Path,
    on_progress: Progress,
    on_warning: Callable[[str], None] = lambda text: None,
    grace_s: float,
    control: Control | None = None,
    stdout: Path | None = None,
    answers: bool = False,
    environment: Mapping[str, str] | None = None,
    finished: Path | None = None,
    is_due: Callable[[], bool] = lambda: True,
    ends_in_order: bool = False,
    forks: bool = False,
) -> None:
    """Run `command` while holding the flock of every one of `folders`; raises StageError when it fails.

    That of `beside` is held, too, and shared with others.

    `finished` is the mark of its success. The command leaves it itself where it can, so that no death of this process
    comes between its end and the mark. Where the mark is there, or the work is not `is_due`, nothing is done.

    The process inherits the locks, so they last until it is gone even where this process dies first. Cancelling sends
    SIGTERM to its session and SIGKILL after `grace_s`, and returns when it is gone. It prints to `log`, or to `stdout`.
    One that `ends_in_order` gets SIGUSR1 instead, when it is cancelled and when this process dies; any other is killed
    when this process dies.
    Where it `answers`, an exit code of 1 with an answer is no failure.
    One that `forks` is the arguments of `spike4dgs`, whose imports are done already; it takes no orders.
    """
    async with _locked(folders, beside) as locks:
        if (finished is not None and finished.exists()) or not is_due():
            return
        mark = {} if finished is None else {"SPIKE4DGS_FINISHED": str(finished)}
        variables = {"SPIKE4DGS_PROGRESS": "json"} | mark | dict(environment or {})
        with log.open("a") as text, stdout.open("w") if stdout else contextlib.nullcontext(text) as printed:
            relay = _Relay(text, on_progress, on_warning)
            running: asyncio.SubprocessTransport | Fork
            teller = None
            if forks:
                running = await fork(relay, command, variables, printed.fileno(), locks)
                send_signal = running.send_signal
            else:
                running, _ = await asyncio.get_running_loop().subprocess_exec(
                    lambda: relay,
                    *leashed(list(command), "SIGUSR1" if ends_in_order else "SIGKILL"),
                    stdin=PIPE if control else DEVNULL,
                    stdout=printed,
                    stderr=PIPE,
                    env=os.environ | variables,
                    start_new_session=True,
                    pass_fds=locks,
                )
                send_signal = partial(os.killpg, running.get_pid())
                teller = asyncio.ensure_future(_tell(running, relay, control)) if control else None
            try:
                await relay.over.wait()
            finally:
                if teller:
                    teller.cancel()
                await _insist(_stop(send_signal, relay, grace_s, signal.SIGUSR1 if ends_in_order else signal.SIGTERM))
                running.close()
        if relay.fault is not None:
            raise relay.fault
        code = running.get_returncode() or 0
        if code != 0 and not (code == 1 and answers and stdout and stdout.stat().st_size):
            raise relay.error or _bad_end(code, relay.last)
        if finished is not None:
            finished.touch()


def _bad_end(code: int, last_line: str) -> StageError:
    """Return the error of a process that ended with `code` and reported none."""
    text = last_line or f"the stage ended with {named_end(code)} and no message"
    if code < 0:
        return KilledError(text, -code)
    return BadInputError(text) if code == _REFUSED else StageError(text)


async def _tell(transport: asyncio.SubprocessTransport, relay: _Relay, control: Control) -> None:
    """Pass on each order once; SIGTERM would kill a process that has not reported anything yet."""
    stdin = cast(asyncio.WriteTransport, transport.get_pipe_transport(0))
    clock = asyncio.get_running_loop().time
    patient_until = clock() + _START_S
    saved = False
    while True:
        if control.save.exists() and not saved:
            saved = True
            stdin.write(b"\n")
        if control.stop.exists() and (relay.began or clock() > patient_until):
            os.killpg(transport.get_pid(), signal.SIGTERM)
            return
        await asyncio.sleep(_CONTROL_POLL_S)


@contextlib.asynccontextmanager
async def _locked(folders: Sequence[Path], beside: Path | None) -> AsyncIterator[list[int]]:
    locks = [*(partial(locked, folder) for folder in folders), *(() if beside is None else (partial(shared, beside),))]
    with contextlib.ExitStack() as stack:
        descriptors: list[int] = []
        while len(descriptors) < len(locks):
            try:
                descriptors.append(stack.enter_context(locks[len(descriptors)]()))
            except BlockingIOError:
                await asyncio.sleep(_LOCK_POLL_S)
        yield descriptors


class _Relay(asyncio.SubprocessProtocol):
    """Reads the process's standard error to its very end: callbacks go on where a cancelled task would not.

    `gone` is set when the process is, `closed` at the end of its output, `over` when it is gone or a fault of ours,
    such as a full disk, leaves no reason to wait for it. `began` says that it has reported progress, `error` is the
    failure that it reported, `last` its last line.
    """

    def __init__(self, log: TextIO, on_progress: Progress, on_warning: Callable[[str], None]) -> None:
        self.gone, self.closed, self.over = asyncio.Event(), asyncio.Event(), asyncio.Event()
        self.began = False
        self.error: StageError | None = None
        self.last = ""
        self.fault: OSError | None = None
        self._log = log
        self._on_progress = on_progress
        self._on_warning = on_warning
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
        """Note that the process is gone; its last output may still be on its way."""
        self.gone.set()
        self.over.set()

    def connection_lost(self, exc: Exception | None) -> None:
        """Note that nothing more will come."""
        if self._pending:
            self._pass_on(self._pending.decode(errors="replace"))
        self.closed.set()

    def _pass_on(self, line: str) -> None:
        try:
            if not self._is_report(line):
                self._log.write(f"{line}\n")
                self._log.flush()
                self.last = line.strip() or self.last
        except OSError as error:
            self.fault = self.fault or error
            self.over.set()

    def _is_report(self, line: str) -> bool:
        """Return whether a line is a report for this process, of progress, a warning or an error, and take it in."""
        if not line.startswith("{"):
            return False
        try:
            event = json.loads(line)
            if event["event"] == "progress":
                self._on_progress(min(max(0.0, float(event["fraction"])), 1.0), str(event["message"]))
                self.began = True
                return True
            if event["event"] == "warning":
                self._on_warning(str(event["message"]))
                return True
            if event["event"] == "error":
                parts = (str(event[name]) for name in ("found", "expected", "do"))
                kind = BadInputError if event.get("bad_input") else StageError
                kind = _BY_NAME.get(event.get("kind"), kind)
                self.error = kind(*parts, where=event["where"])
                return True
        except (ValueError, KeyError, TypeError):
            pass
        return False


async def _stop(send_signal: Callable[[int], None], relay: _Relay, grace_s: float, word: signal.Signals) -> None:
    for number, patience_s in ((word, grace_s), (signal.SIGKILL, None)):
        if relay.gone.is_set():
            break
        with contextlib.suppress(ProcessLookupError):
            send_signal(number)
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
