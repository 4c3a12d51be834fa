"""Measures how fast a disk takes a recording, by direct writes from several threads to a file that no one sees."""

import mmap
import os
import shutil
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from acquisition.errors import DiskError
from acquisition.recording.direct import DirectFile

_WRITE_BYTES = 4 << 20
_THREADS = 4
_MOST_BYTES = 1 << 30  # size of the file, which is written over and over


@dataclass(frozen=True)
class DiskSpeed:
    """A disk's MB/s; `direct` is false where the file system only takes writes through the page cache."""

    mb_s: float
    direct: bool


def write_speed(folder: Path, seconds: float, clock: Callable[[], float] = time.monotonic) -> DiskSpeed:
    """Write into `folder` for `seconds` and leave nothing; raises DiskError where the disk refuses or is full."""
    try:
        step = _THREADS * _WRITE_BYTES
        size = min(_MOST_BYTES, shutil.disk_usage(folder).free // 2) // step * step
        if not size:
            raise DiskError("found no room for a disk test", f"{2 * step} bytes free", where=folder)
        path = folder / f".disk-test-{os.getpid()}"
        file = DirectFile(path)
        try:
            path.unlink()  # it goes when the handle does, whatever happens
            return _measure(file, size, seconds, clock)
        finally:
            file.abandon()
    except OSError as error:
        raise DiskError(f"cannot be written ({error.strerror})", "a disk", where=folder) from error


def _measure(file: DirectFile, size: int, seconds: float, clock: Callable[[], float]) -> DiskSpeed:
    data = memoryview(mmap.mmap(-1, _WRITE_BYTES))  # aligned to a page
    data[:] = os.urandom(_WRITE_BYTES)
    begin, part = clock(), size // _THREADS

    def fill(first: int) -> int:
        written = 0
        while clock() - begin < seconds or not written:
            file.write(data, first + written % part)
            written += _WRITE_BYTES
        return written

    with ThreadPoolExecutor(_THREADS) as pool:
        total = sum(pool.map(fill, range(0, size, part)))
    file.finish(size)
    return DiskSpeed(total / max(clock() - begin, 1e-9) / 1e6, file.direct)
