"""A file written past the page cache, in aligned chunks, with its space reserved ahead."""

import contextlib
import ctypes
import errno
import fcntl
import functools
import os
from pathlib import Path

ALIGNMENT = 4096
_KEEP_SIZE = 1
_NOT_DIRECT = (errno.EINVAL, errno.EOPNOTSUPP)


class DirectFile:
    """A new file for one writer; `direct` turns false where the file system refuses O_DIRECT, and writes go on."""

    def __init__(self, path: Path):
        self.path = path
        self.direct = True
        self.reserved = 0
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        try:
            fcntl.fcntl(self._handle, fcntl.F_SETFL, fcntl.fcntl(self._handle, fcntl.F_GETFL) | os.O_DIRECT)
        except OSError:
            self.direct = False

    def write(self, data: memoryview, offset: int) -> None:
        """Put `data` at `offset`; both aligned, or the page cache takes them. Raises OSError when the disk refuses."""
        while data:
            if self.direct and (len(data) % ALIGNMENT or offset % ALIGNMENT):  # what a short write leaves
                self._buffer_writes()
            try:
                done = os.pwrite(self._handle, data, offset)
            except OSError as error:
                if not self.direct or error.errno not in _NOT_DIRECT:
                    raise
                self._buffer_writes()
                continue
            data, offset = data[done:], offset + done

    def reserve(self, size: int) -> None:
        """Take disk blocks for the first `size` bytes; the file keeps its own size, so that a crash leaves no zeros.

        Raises OSError where there is no room; a file system that cannot reserve just fills up as it goes.
        """
        if size > self.reserved:
            done = _libc().fallocate(self._handle, _KEEP_SIZE, self.reserved, size - self.reserved)
            number = ctypes.get_errno()
            if done and number not in (errno.EOPNOTSUPP, errno.ENOSYS):
                self.cut(os.fstat(self._handle).st_size)  # gives back what was taken before the disk was full
                raise OSError(number, os.strerror(number), str(self.path))
            self.reserved = size

    def finish(self, size: int) -> None:
        """Cut or stretch the file to `size` bytes (zeros, without blocks), put it on the disk, close it."""
        try:
            os.ftruncate(self._handle, size)
            os.fsync(self._handle)
        finally:
            self.abandon()

    def cut(self, size: int) -> None:
        """Forget what lies beyond `size` bytes, or stretch the file to it with zeros."""
        os.ftruncate(self._handle, size)

    def abandon(self) -> None:
        """Close the file as it is, if it is still open."""
        handle, self._handle = self._handle, -1
        if handle >= 0:
            with contextlib.suppress(OSError):
                os.close(handle)

    def _buffer_writes(self) -> None:
        fcntl.fcntl(self._handle, fcntl.F_SETFL, fcntl.fcntl(self._handle, fcntl.F_GETFL) & ~os.O_DIRECT)
        self.direct = False


@functools.cache
def _libc() -> ctypes.CDLL:
    libc = ctypes.CDLL(None, use_errno=True)
    libc.fallocate.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_int64, ctypes.c_int64]
    return libc
