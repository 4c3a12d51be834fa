"""Keeps the worker of `serve --with-worker` running: one that ends is started again, after pauses that grow."""

import logging
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from server.work.leash import leashed, named_end, stop_process

_POLL_S = 0.2
_SHORT_LIFE_S = 60.0
_LONGEST_PAUSE_S = 64.0
_SHORT_LIVES = 8  # in a row, after which it is given up


class Keeper:
    """Runs `command` until told to stop.

    `trouble` says what keeps it from running, None while it runs; `given_up` that it is not started again.
    """

    def __init__(self, command: Sequence[str], grace_s: float, pause_s: float = 1.0) -> None:
        self._command = list(command)
        self._grace_s = grace_s
        self._pause_s = pause_s
        self._stop = threading.Event()
        self.trouble: str | None = None
        self.given_up = False

    @contextmanager
    def running(self) -> Iterator[None]:
        """Keep the process running inside the block, and stop it in order at its end."""
        # The kernel ends a leashed process with the thread that started it, so that thread does nothing else.
        thread = threading.Thread(target=self._keep, name="keeper")
        thread.start()
        try:
            yield
        finally:
            self.stop()
            thread.join()

    def stop(self) -> None:
        """Let the process end in order, without waiting for it; it is not started again."""
        self._stop.set()

    def _keep(self) -> None:
        log = logging.getLogger(__name__)
        short_lives = 0
        while short_lives < _SHORT_LIVES:
            born = time.monotonic()
            end = self._live()
            if self._stop.is_set():
                return
            short_lives = short_lives + 1 if time.monotonic() - born < _SHORT_LIFE_S else 1
            pause_s = min(self._pause_s * 2 ** (short_lives - 1), _LONGEST_PAUSE_S)
            self.trouble = f"the worker ended with {end}; it starts again in {pause_s:g} s"
            log.warning(self.trouble)
            if self._stop.wait(pause_s):
                return
        self.trouble = f"the worker ended {short_lives} times within seconds; mend what the log says, then start again"
        self.given_up = True
        log.error(self.trouble)

    def _live(self) -> str:
        """Run the process to its end, which it names; one that still runs when told to stop is stopped."""
        # In its own session, so that Ctrl-C reaches this process only, which then stops the worker in order.
        process = subprocess.Popen(leashed(self._command, "SIGTERM"), start_new_session=True)
        self.trouble = None
        while process.poll() is None:
            if self._stop.wait(_POLL_S):
                stop_process(process, self._grace_s)
        return named_end(process.returncode)
