"""The one thread that brings a stream's chunks from its ring to its file."""

import contextlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from acquisition.recording.direct import ALIGNMENT, DirectFile
from acquisition.recording.journal import SUFFIX, Journal
from acquisition.recording.ring import Chunk, ChunkRing

RING_BYTES = 16 << 20
RESERVE_BYTES = 64 << 20  # space taken at a time where the length is not known


@dataclass(frozen=True)
class StreamSpace:
    """The memory and the disk of a stream: the ring's size, the planes expected (None where nobody knows).

    `allows` is asked before more of the disk is taken than was reserved; `open_file` opens the file.
    """

    ring_bytes: int = RING_BYTES
    planes: int | None = None
    allows: Callable[[int], bool] = lambda size: True
    open_file: Callable[[Path], DirectFile] = DirectFile


class ChunkWriter:
    """Writes the chunks of `ring` to `path` in a thread, and keeps the journal's lines that then hold.

    `failure` is what the disk refused; from then on the ring takes nothing more.
    """

    def __init__(self, path: Path, ring: ChunkRing, space: StreamSpace, plane_bytes: int):
        self.failure: OSError | None = None
        self.written = 0  # the file's first bytes that are on the disk
        self.file = space.open_file(path)
        self.journal = Journal(path.with_suffix(SUFFIX))
        self._ring, self._space = ring, space
        self._expected_bytes = None if space.planes is None else space.planes * plane_bytes
        self._thread = threading.Thread(target=self._write_chunks, name=f"write {path.stem}", daemon=True)
        self._thread.start()

    def promise(self, end: int, record: dict) -> None:
        """Note that `record` holds when the file's first `end` bytes are written, which may already be so."""
        self.journal.promise(end, record)
        if end <= self.written:  # the thread may have looked just before, and nothing else may come
            self._ring.wake()

    def join(self) -> None:
        """Wait until all that the closed ring holds is written or refused."""
        self._thread.join()

    def finish(self, size: int) -> None:
        """Cut or stretch the file to `size` bytes and bring it to the disk; raises OSError when the disk refuses."""
        self.file.finish(size)
        if not self.failure:
            self.journal.keep(size)

    def abandon(self) -> None:
        """Close file and journal as they are, if they are still open."""
        self.file.abandon()
        self.journal.close()

    def _write_chunks(self) -> None:
        while (chunk := self._ring.take()) is not None:
            try:
                if chunk.used:
                    self._write(chunk)
                self.journal.keep(self.written)
            except OSError as error:
                self.failure = error
                self._ring.refuse()
                return
            if chunk.used:
                self._ring.give_back(chunk)

    def _write(self, chunk: Chunk) -> None:
        data = self._ring.data(chunk, ALIGNMENT)
        if chunk.offset + len(data) > self.file.reserved:
            self._reserve(chunk.offset + len(data))
        self.file.write(data, chunk.offset)
        self.written = chunk.offset + chunk.used

    def _reserve(self, size: int) -> None:
        """Take all the space a run of known length needs, or more ahead while the disk may be filled."""
        with contextlib.suppress(OSError):  # where there is no room, the write itself says so
            if self._expected_bytes is not None:
                self.file.reserve(max(size, self._expected_bytes))
            elif self._space.allows(RESERVE_BYTES):
                self.file.reserve(size + RESERVE_BYTES)
