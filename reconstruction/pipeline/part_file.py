"""Keeps what is learnt of one part of a training: once, by the first process that has all of it.

Processes of one host leave a part to the one that has begun it, as long as that one gives signs of life. This saves
work and nothing depends on it: where two learn the same, on two hosts or because one had stood still, the second result
is dropped.
"""

import fcntl
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquisition.durable import write_first
from reconstruction.run.parts import PartFolder
from reconstruction.tensors import packed, read_tensors

SILENT_S = 30.0  # without a sign of life, after which a process is not waited for
_POLL_S = 0.2
Beat = Callable[[], None]


@dataclass
class PartFile:
    """The file of the part `name`; `pause` waits for so many seconds, and raises where the process is told to stop."""

    folder: PartFolder
    name: str
    pause: Callable[[float], None] = time.sleep
    clock: Callable[[], float] = time.time

    @property
    def is_there(self) -> bool:
        """Tell whether all of the part is there."""
        return self.folder.file(self.name).exists()

    def read(self) -> dict[str, Any]:
        """Return the content; raises BadRunError where it is missing or damaged."""
        return read_tensors(self.folder.file(self.name), "a part of a training", "run the train stage again")

    def keep(self, learn: Callable[[Beat], dict[str, Any]]) -> bool:
        """Keep what `learn` returns, unless the part is there; return whether it was kept.

        `learn` is given what it calls now and then as a sign of life.
        """
        self.folder.path.mkdir(parents=True, exist_ok=True)
        # What is written into an open folder has no place once that is removed, as it is when a run is restarted.
        with _opened(self.folder.path) as folder, self._alone(folder) as beat:
            return not self.is_there and write_first(folder, self.folder.file(self.name).name, packed(learn(beat)))

    @contextmanager
    def _alone(self, folder: int) -> Iterator[Beat]:
        """Wait until no other process of this host that gives signs of life learns the part, or until it is there."""
        lock = os.open(f"{self.name}.lock", os.O_CREAT | os.O_RDWR, 0o644, dir_fd=folder)
        try:
            while not (_is_mine(lock) or self.is_there or self._is_silent(lock)):
                self.pause(_POLL_S)
            os.utime(lock)
            yield lambda: os.utime(lock)
        finally:
            os.close(lock)

    def _is_silent(self, lock: int) -> bool:
        return self.clock() - os.fstat(lock).st_mtime > SILENT_S


@contextmanager
def _opened(path: Path) -> Iterator[int]:
    number = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield number
    finally:
        os.close(number)


def _is_mine(lock: int) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a disk without locks
        return True
    return True
