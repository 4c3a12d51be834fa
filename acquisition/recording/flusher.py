"""Brings growing files to the disk once a second, so that a power cut costs a recording no more than that."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

EVERY_S = 1.0


class Flusher:
    """Flushes the files of `folder` that match `patterns`, in a thread of its own, as long as the block lasts.

    Each is opened anew, so whoever writes it may close it at any time. `failure` is the first error of the disk,
    `rounds` and `spent_s` are how often all were flushed and how long that took.
    """

    def __init__(self, folder: Path, *patterns: str, every_s: float = EVERY_S) -> None:
        self.failure: OSError | None = None
        self.rounds, self.spent_s = 0, 0.0
        self._folder, self._patterns, self._every_s = folder, patterns, every_s
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._flush, name="flush", daemon=True)

    def __enter__(self) -> Flusher:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _flush(self) -> None:
        while not self._over.wait(self._every_s):
            began = time.perf_counter()
            for pattern in self._patterns:  # in their order: what a file promises comes after it
                for path in self._folder.glob(pattern):
                    self._flush_file(path)
            self.rounds, self.spent_s = self.rounds + 1, self.spent_s + time.perf_counter() - began

    def _flush_file(self, path: Path) -> None:
        try:
            handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        except FileNotFoundError:  # it is whole, and has another name
            return
        try:
            os.fdatasync(handle)
        except OSError as error:
            self.failure = self.failure or error
        finally:
            os.close(handle)
