"""Starts stages as forks of a process that has imported what they need, so that each begins at once.

The library keeps that process. It lives as long as this one, from the first fork on.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import runpy
import signal
import sys
import threading
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from server.work.leash import die_with_parent

_IMPORTED = ["server.cli.reconstruct", "reconstruction.pipeline.span_stage"]


class Fork:
    """A running fork, with the names that `asyncio` has for a process; `relay` is told of its end."""

    def __init__(self, process: BaseProcess, relay: asyncio.SubprocessProtocol) -> None:
        self._process = process
        self._relay = relay
        asyncio.get_running_loop().add_reader(process.sentinel, self._end)

    def send_signal(self, number: int) -> None:
        """Send it a signal; raises ProcessLookupError where it is gone."""
        if self._process.exitcode is not None or self._process.pid is None:
            raise ProcessLookupError
        os.kill(self._process.pid, number)

    def get_returncode(self) -> int | None:
        """Return its exit code, or the negative number of the signal that ended it; None while it runs."""
        return self._process.exitcode

    def close(self) -> None:
        """Kill it, if it still runs, and listen no more."""
        asyncio.get_running_loop().remove_reader(self._process.sentinel)
        if self._process.exitcode is None:
            self._process.kill()

    def _end(self) -> None:
        asyncio.get_running_loop().remove_reader(self._process.sentinel)
        self._process.join()
        self._relay.process_exited()


async def fork(
    relay: asyncio.SubprocessProtocol,
    arguments: Sequence[str],
    environment: Mapping[str, str],
    printed: int,
    locks: Sequence[int],
) -> Fork:
    """Run `spike4dgs` with `arguments` and more variables in a fork, which inherits the descriptors of `locks`.

    It prints to the descriptor `printed`, and `relay` reads its standard error. It cannot outlive this process.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(_IMPORTED)
    readable, writable = os.pipe()
    given = [Connection(os.dup(number)) for number in (printed, *locks)]
    error = Connection(writable)
    process = context.Process(target=_run, args=(list(arguments), dict(environment), error, *given))
    start = asyncio.ensure_future(asyncio.to_thread(process.start))
    pipe = os.fdopen(readable, "rb", 0)
    try:
        await asyncio.shield(start)
        await asyncio.get_running_loop().connect_read_pipe(lambda: _Reader(relay), pipe)
    except BaseException:
        start.add_done_callback(lambda started: started.exception() or process.kill())
        pipe.close()
        raise
    finally:
        for one in (error, *given) if start.done() else ():
            one.close()
    return Fork(process, relay)


class _Reader(asyncio.Protocol):
    """Passes on what comes through a pipe as a process's standard error."""

    def __init__(self, relay: asyncio.SubprocessProtocol) -> None:
        self._relay = relay

    def data_received(self, data: bytes) -> None:
        self._relay.pipe_data_received(2, data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._relay.connection_lost(exc)


def _run(arguments: list[str], environment: Mapping[str, str], error: Connection, *given: Connection) -> None:
    """Become a stage: in the fork, with its descriptors, of which `given` are where it prints, and locks."""
    os.setsid()
    die_with_parent(signal.SIGKILL)
    threading.Thread(target=_die_with_worker, daemon=True).start()
    for number, stream in ((1, given[0]), (2, error)):
        os.dup2(stream.fileno(), number)
        stream.close()
    os.environ.update(environment)
    sys.argv = ["spike4dgs", *arguments]
    runpy.run_module("server.cli", run_name="__main__")


def _die_with_worker() -> None:
    """End this process when the one that asked for it dies: it is no child of it, so the kernel does not."""
    asker = multiprocessing.parent_process()
    assert asker is not None
    wait([asker.sentinel])
    os.kill(os.getpid(), signal.SIGKILL)
