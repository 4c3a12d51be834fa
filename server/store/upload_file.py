"""The bytes of an upload on disk, to which one writer at a time appends."""

import hashlib
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from server.errors import NotFoundError, OffsetError, StateError, UploadDiskError, UploadSizeError
from server.store.files import locked

MOST_CAMERA_BYTES = 16 << 20  # of an upload that is read whole, as a file of cameras is
_FREE_EVERY = 1 << 20  # bytes, at most, between two looks at the free disk


@contextmanager
def held(path: Path) -> Iterator[int]:
    """Open the file and hold its flock; yields the descriptor.

    Raises StateError where somebody else holds it, NotFoundError where the file is gone: a database that was put back
    from a backup names uploads whose bytes are not in it.
    """
    with ExitStack() as stack:
        try:
            descriptor = stack.enter_context(locked(path, os.O_RDWR | os.O_NOFOLLOW))
        except BlockingIOError as error:
            raise StateError(
                f"found another request at work on the upload {path.parent.name}", "one at a time", "try again"
            ) from error
        except FileNotFoundError as error:
            raise NotFoundError(
                f"found no bytes of the upload {path.parent.name}", "those that came", "delete it and send them again"
            ) from error
        yield descriptor


def digest_of(descriptor: int) -> str:
    """Return the SHA-256 of the whole file, in hexadecimal digits."""
    with os.fdopen(os.dup(descriptor), "rb") as file:
        file.seek(0)
        return hashlib.file_digest(file, "sha256").hexdigest()


class Appender:
    """Appends to the file behind a descriptor up to `total` bytes, leaving `keep_free` bytes of the disk.

    Raises OffsetError where the file does not end at `offset`. What was written stays where a later write fails for
    want of room; where the client sent more than it said, nothing of this request does.
    """

    def __init__(self, descriptor: int, path: Path, offset: int, *, total: int, keep_free: int) -> None:
        self.offset = os.fstat(descriptor).st_size
        if offset != self.offset:
            raise OffsetError(offset, self.offset)
        self._start = offset
        self._descriptor = descriptor
        self._folder = path.parent
        self._total = total
        self._keep_free = keep_free

    def expect(self, length: int) -> None:
        """Raise UploadSizeError where `length` more bytes are too many."""
        if self.offset + length > self._total:
            raise UploadSizeError(
                f"found {self.offset + length} bytes", f"the {self._total} that the upload was made for"
            )

    def write(self, data: bytes) -> None:
        """Append; raises UploadSizeError and UploadDiskError."""
        try:
            self.expect(len(data))
        except UploadSizeError:
            self._back()
            raise
        for first in range(0, len(data), _FREE_EVERY):
            self._write(memoryview(data)[first : first + _FREE_EVERY])

    def sync(self) -> None:
        """Flush to the disk; raises UploadDiskError, and forgets this request's bytes, where it refuses."""
        try:
            os.fsync(self._descriptor)
        except OSError as error:
            self._back()
            raise self._no_room(error.strerror) from error

    def _write(self, part: memoryview) -> None:
        if shutil.disk_usage(self._folder).free < self._keep_free + len(part):
            raise self._no_room(f"less than {self._keep_free} bytes would stay free")
        while part:
            try:
                written = os.pwrite(self._descriptor, part, self.offset)
            except OSError as error:
                raise self._no_room(error.strerror) from error
            self.offset += written
            part = part[written:]

    def _no_room(self, reason: str | None) -> UploadDiskError:
        return UploadDiskError(reason or "the disk refused", self.offset)

    def _back(self) -> None:
        os.ftruncate(self._descriptor, self._start)
        self.offset = self._start
