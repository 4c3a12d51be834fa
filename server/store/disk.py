"""The disk of a data folder: some of it stays free, and a reserve is given up for what makes room."""

import os
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_RESERVE_BYTES = 16 << 20
_MOST = 32  # the reserve is at most this part of a disk


class Disk:
    """The disk under `folder`, of which work leaves `keep_free` bytes."""

    def __init__(self, folder: Path, keep_free: int) -> None:
        self._folder = folder
        self.keep_free = keep_free
        self._reserve = folder / "reserve"
        self._reserve_bytes = min(_RESERVE_BYTES, shutil.disk_usage(folder).total // _MOST)
        self._lock = threading.Lock()
        self._making_room = 0  # blocks that are being run

    def free(self) -> int:
        """Return the bytes that work may fill, at least 0."""
        return max(0, shutil.disk_usage(self._folder).free - self.keep_free)

    def keep_reserve(self) -> None:
        """Take the reserve, where it is not taken yet and there is room for it."""
        if self._reserve.exists():
            return
        aside = self._reserve.with_suffix(".partial")
        with suppress(OSError), aside.open("wb") as file:
            os.posix_fallocate(file.fileno(), 0, self._reserve_bytes)
            aside.rename(self._reserve)
        aside.unlink(missing_ok=True)

    @contextmanager
    def making_room(self) -> Iterator[None]:
        """Give up the reserve for the block where the disk is full: even a deletion is written to a database first."""
        with self._lock:
            if shutil.disk_usage(self._folder).free < self._reserve_bytes:
                self._reserve.unlink(missing_ok=True)
            self._making_room += 1  # once the disk has answered
        try:
            yield
        finally:
            with self._lock:
                self._making_room -= 1
                if self._making_room == 0:
                    self.keep_reserve()
