"""The bounded memory between a camera and its file: aligned chunks, filled by one thread and written by another.

The memory is an anonymous mapping, aligned to pages as direct writes want it. It is private to the process: `bench
recorder` shows that one process feeds nine files at the disk's own rate on less than a core.
"""

import mmap
import threading
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Chunk(NamedTuple):
    """Bytes [offset, offset + used) of the file, at the front of slot `slot`; none of them where the taker is woken."""

    slot: int
    offset: int
    used: int


class ChunkRing:
    """A file's bytes on their way, in slots of `chunk_bytes` (a multiple of the page) of one anonymous mapping.

    One thread puts, one takes. Bytes that were lost are skipped, not stored: whole chunks of them never reach the
    writer, so that the file has a hole there, which reads as zeros.
    """

    def __init__(self, slots: int, chunk_bytes: int):
        self.chunk_bytes = chunk_bytes
        self.slots = slots
        self.position = 0  # the file's bytes that were put or skipped
        self._memory = np.frombuffer(mmap.mmap(-1, slots * chunk_bytes), dtype=np.uint8)
        self._free = list(range(slots))  # the slot given back last is the warmest in the cache
        self._ready: deque[Chunk] = deque()
        self._filling = -1
        self._closed = False
        self._changed = threading.Condition()

    @property
    def fullness(self) -> float:
        """The part of the slots in use, in [0, 1]."""
        return 1 - len(self._free) / self.slots

    def offer(self, data: NDArray[np.uint8]) -> bool:
        """Put bytes [n], all of them or, where there is no room, none; returns which. Never waits."""
        touched = (self.position + len(data) - 1) // self.chunk_bytes - self.position // self.chunk_bytes + 1
        if self._closed or touched - (self._filling >= 0) > len(self._free):
            return False
        self._put(data)
        return True

    def put(self, data: NDArray[np.uint8]) -> bool:
        """Put bytes [n], waiting for room as often as needed; returns False once the ring is closed."""
        while len(data):
            room = self.chunk_bytes - self.position % self.chunk_bytes
            if self._filling < 0:
                with self._changed:
                    self._changed.wait_for(lambda: self._free or self._closed)
            if self._closed:
                return False
            self._put(data[:room])
            data = data[room:]
        return True

    def skip(self, count: int) -> None:
        """Leave out `count` bytes, which become zeros in the file. Never waits."""
        if self._filling >= 0:
            start = self.position % self.chunk_bytes
            inside = min(count, self.chunk_bytes - start)
            self._slot(self._filling)[start : start + inside] = 0
            self._advance(inside)
            count -= inside
        self.position += count

    def close(self) -> None:
        """Promise that nothing more will be put; the taker gets the rest."""
        if self._filling >= 0:
            self._hand_over(self.position % self.chunk_bytes)
        self.refuse()

    def refuse(self) -> None:
        """Take nothing more: the thread that writes calls this when it cannot."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def wake(self) -> None:
        """Give the taker an empty chunk, so that it looks up although there is nothing to write."""
        with self._changed:
            self._ready.append(Chunk(-1, self.position, 0))
            self._changed.notify_all()

    def take(self) -> Chunk | None:
        """Wait for the next chunk to write; returns None when there will be no more."""
        with self._changed:
            self._changed.wait_for(lambda: self._ready or self._closed)
            return self._ready.popleft() if self._ready else None

    def data(self, chunk: Chunk, alignment: int = 1) -> memoryview:
        """Return the chunk's bytes, with zeros behind them up to a multiple of `alignment`."""
        padded = -(-chunk.used // alignment) * alignment
        slot = self._slot(chunk.slot)
        slot[chunk.used : padded] = 0
        return slot[:padded].data

    def give_back(self, chunk: Chunk) -> None:
        """Give back a chunk that is on the disk; its slot may be filled again."""
        with self._changed:
            self._free.append(chunk.slot)
            self._changed.notify_all()

    def _put(self, data: NDArray[np.uint8]) -> None:
        while len(data):
            start = self.position % self.chunk_bytes
            if self._filling < 0:
                with self._changed:
                    self._filling = self._free.pop()
                self._slot(self._filling)[:start] = 0  # what was skipped before
            inside = min(len(data), self.chunk_bytes - start)
            np.copyto(self._slot(self._filling)[start : start + inside], data[:inside])
            self._advance(inside)
            data = data[inside:]

    def _advance(self, count: int) -> None:
        self.position += count
        if self.position % self.chunk_bytes == 0:
            self._hand_over(self.chunk_bytes)

    def _hand_over(self, used: int) -> None:
        offset = (self.position - 1) // self.chunk_bytes * self.chunk_bytes
        with self._changed:
            self._ready.append(Chunk(self._filling, offset, used))
            self._filling = -1
            self._changed.notify_all()

    def _slot(self, slot: int) -> NDArray[np.uint8]:
        return self._memory[slot * self.chunk_bytes : (slot + 1) * self.chunk_bytes]
