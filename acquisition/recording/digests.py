"""Digests of a stream: xxh3-64 of every block of planes, SHA-256 of the whole file."""

import functools
import hashlib
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import xxhash
from numpy.typing import NDArray

from acquisition.progress import Progress, silent

Digests = tuple[str, tuple[str, ...]]  # SHA-256 of all planes, xxh3-64 of each block


class BlockDigests:
    """Counts the planes of a stream and digests each block of `block_planes` planes, `plane_bytes` bytes a plane.

    `ended` is called for each block with its number, its planes and its digest.
    """

    def __init__(self, block_planes: int, plane_bytes: int, ended: Callable[[int, int, str], None]):
        self.planes = 0
        self.digests: list[str] = []
        self._block_planes, self._plane_bytes, self._ended = block_planes, plane_bytes, ended
        self._block = xxhash.xxh3_64()

    def add(self, data: NDArray[np.uint8]) -> None:
        """Take planes [n, B]."""
        while len(data):
            part = data[: self._room]
            self._block.update(part.data)
            self._count(len(part))
            data = data[len(part) :]

    def add_zeros(self, planes: int) -> None:
        """Take planes of zeros."""
        while planes:
            part = min(planes, self._room)
            if part == self._block_planes:
                self._count(part, _zeros_digest(part * self._plane_bytes))
            else:
                self._block.update(bytes(part * self._plane_bytes))
                self._count(part)
            planes -= part

    def finish(self) -> None:
        """End the last block, which may be shorter than the others."""
        if self.planes % self._block_planes:
            self._end_block(self.planes % self._block_planes)

    def keep(self, planes: int) -> None:
        """Forget the digests of blocks that do not lie within the first `planes` planes."""
        del self.digests[planes // self._block_planes :]

    @property
    def _room(self) -> int:
        return self._block_planes - self.planes % self._block_planes

    def _count(self, planes: int, digest: str = "") -> None:
        self.planes += planes
        if self.planes % self._block_planes == 0:
            self._end_block(self._block_planes, digest)

    def _end_block(self, planes: int, digest: str = "") -> None:
        self.digests.append(digest or self._block.hexdigest())
        self._block.reset()
        self._ended(len(self.digests) - 1, planes, self.digests[-1])


@functools.cache
def _zeros_digest(size: int) -> str:
    return xxhash.xxh3_64_hexdigest(bytes(size))


def digests_of(path: Path, block_bytes: int, size: int | None = None, progress: Progress = silent) -> Digests:
    """Read the SHA-256 of a file, or of its first `size` bytes, and the xxh3-64 of each of their blocks."""
    total = path.stat().st_size if size is None else size
    sha256, blocks, left = hashlib.sha256(), [], total
    with path.open("rb") as file:
        while data := file.read(min(block_bytes, left)):
            sha256.update(data)
            blocks.append(xxhash.xxh3_64_hexdigest(data))
            left -= len(data)
            progress(1 - left / total, path.name)
    return sha256.hexdigest(), tuple(blocks)


def planes_digests(blocks: Iterable[NDArray[np.uint8]], block_planes: int, plane_bytes: int) -> Digests:
    """Return what `digests_of` finds in a file of the planes [T, B] in `blocks`, which may have any length."""
    sha256, digests = hashlib.sha256(), BlockDigests(block_planes, plane_bytes, lambda *_: None)
    for planes in blocks:
        sha256.update(planes.data)
        digests.add(planes)
    digests.finish()
    return sha256.hexdigest(), tuple(digests.digests)
