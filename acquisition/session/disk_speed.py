"""Measures how fast a disk takes a recording, by direct writes from several threads to a file that no one sees."""

import errno
import mmap
import os
import shutil
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from acquisition.errors import DiskError

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
        try:
            return _measure(folder, os.O_DIRECT, size, seconds, clock)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP):
                raise
            return _measure(folder, 0, size, seconds, clock)
    except OSError as error:
        raise DiskError(f"cannot be written ({error.strerror})", "a disk", where=folder) from error


def _measure(folder: Path, flag: int, size: int, seconds: float, clock: Callable[[], float]) -> DiskSpeed:
    path = folder / f".disk-test-{os.getpid()}"
    handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | flag, 0o600)
    try:
        path.unlink()  # it goes when the handle does, whatever happens
        with mmap.mmap(-1, _WRITE_BYTES) as data, ThreadPoolExecutor(_THREADS) as pool:  # aligned to a page
            data.write(os.urandom(_WRITE_BYTES))
            begin = clock()
            part = size // _THREADS

            def fill(first: int) -> int:
                written = 0
                while clock() - begin < seconds or not written:
                    written += os.pwrite(handle, data, first + written % part)
                return written

            total = sum(pool.map(fill, range(0, size, part)))
            os.fsync(handle)
            return DiskSpeed(total / max(clock() - begin, 1e-9) / 1e6, bool(flag))
    finally:
        os.close(handle)
