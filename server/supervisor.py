"""Runs one stage as one process: locked, leashed, reporting, and stopped when the stage is cancelled."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import json
import os
import signal
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncIterator, Coroutine, Sequence
from pathlib import Path

from acquisition.progress import Progress
from server.errors import ServiceError
from server.leash import leashed

_LOCK_POLL_S = 0.1
_LONGEST_LINE = 65536


class StageError(ServiceError):
    """A stage ended badly; the message is the last line it wrote."""


async def supervise(
    command: Sequence[str], *, folders: Sequence[Path], log: Path, on_progress: Progress, grace_s: float
) -> None:
    """Run `command` while holding the flock of every one of `folders`; raises StageError when it fails.

    The process inherits the locks, so they last until it is gone even where this process dies first. Cancelling sends
    SIGTERM to its session and SIGKILL after `grace_s`, and returns when it is gone.
    """
    async with _locked(folders) as locks:
        with log.open("a") as text:
            process = await asyncio.create_subprocess_exec(
                *leashed(list(command), "SIGKILL"),
                stdin=DEVNULL,
                stdout=text,
                stderr=PIPE,
                env=os.environ | {"SPIKE4DGS_PROGRESS": "json"},
                start_new_session=True,
                pass_fds=locks,
            )
            last = ""
            try:
                async for line in _lines(process):
                    if not _reported(line, on_progress):
                        text.write(f"{line}\n")
                        text.flush()
                        last = line.strip() or last
                code = await process.wait()
            finally:
                await _insist(_stop(process, grace_s))
    if code != 0:
        ended = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        raise StageError(last.removeprefix("spike4dgs: ") or f"the stage ended with {ended} and no message")


def is_locked(folder: Path) -> bool:
    """Whether some process holds the folder's flock."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


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


async def _lines(process: Process) -> AsyncIterator[str]:
    """Lines of the standard error; one longer than 64 KiB comes in pieces."""
    assert process.stderr is not None
    pending = b""
    while chunk := await process.stderr.read(_LONGEST_LINE):
        *whole, pending = (pending + chunk).split(b"\n")
        for line in whole:
            yield line.decode(errors="replace")
        if len(pending) > _LONGEST_LINE:
            yield pending.decode(errors="replace")
            pending = b""
    if pending:
        yield pending.decode(errors="replace")


def _reported(line: str, on_progress: Progress) -> bool:
    if not line.startswith("{"):
        return False
    try:
        event = json.loads(line)
        if event["event"] != "progress":
            return False
        on_progress(min(max(float(event["fraction"]), 0.0), 1.0), str(event["message"]))
    except (ValueError, KeyError, TypeError):
        return False
    return True


async def _stop(process: Process, grace_s: float) -> None:
    for number, patience_s in ((signal.SIGTERM, grace_s), (signal.SIGKILL, None)):
        if process.returncode is not None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(process.wait(), patience_s)


async def _insist(work: Coroutine[None, None, None]) -> None:
    """Finish `work` however often the caller is cancelled meanwhile: a closing event loop cancels more than once."""
    task = asyncio.ensure_future(work)
    while not task.done():
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.shield(task)
    task.result()
