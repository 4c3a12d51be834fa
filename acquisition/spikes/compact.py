"""Planes in a compact file: independent blocks, of which only those that are asked for are decoded.

A block holds up to `block_planes` planes as the trains of their pixels (`transposed`): one Zstandard frame, with its
length and a checksum. Blocks lie one behind another; the manifest holds how long each is.
"""

from __future__ import annotations

import copy
import functools
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zstandard
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError
from acquisition.spikes.transposed import Bytes, planes_of, trains_of

MOST_PLANES, MOST_BYTES = 400, 1 << 24  # most planes and bytes of a block that is written
SUFFIX = ".compact"
KEPT_BLOCKS = 2  # decoded blocks of one camera that stay in memory
LEVEL = 7  # Zstandard's; `bench compact` has the others


def block_planes_of(plane_bytes: int) -> int:
    """Return how many planes share a block: a multiple of eight, 400 or as many as make 16 MiB."""
    return max(8, min(MOST_PLANES, MOST_BYTES // plane_bytes) // 8 * 8)


def encode(planes: Bytes) -> bytes:
    """Return planes [T, B] as a block."""
    return zstandard.ZstdCompressor(level=LEVEL, write_checksum=True).compress(trains_of(planes).data)


def decode(block: bytes | memoryview, planes: int, plane_bytes: int) -> Bytes:
    """Return the planes [T, B] of a block; raises BadRecordingError where it does not hold them."""
    groups = -(-planes // 8)
    expected = f"{planes} planes of {plane_bytes} bytes"
    try:
        held = zstandard.frame_content_size(block)
        if held != 8 * plane_bytes * groups:
            raise BadRecordingError(f"found a block of {held} bytes", expected)
        trains = zstandard.ZstdDecompressor().decompress(block, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise BadRecordingError(f"found a block that cannot be decoded ({error})", expected) from error
    return planes_of(np.frombuffer(trains, dtype=np.uint8).reshape(8 * plane_bytes, groups), planes)


class _Blocks(NamedTuple):
    """The bytes of a compact file, and where its blocks end."""

    path: Path
    data: NDArray[np.uint8]
    ends: tuple[int, ...]
    block_planes: int
    shape: tuple[int, int]

    def decoded(self, number: int) -> Bytes:
        first = number * self.block_planes
        last = min(first + self.block_planes, self.shape[0])
        with BadRecordingError.located(f"{self.path}: block {number} (planes {first} to {last - 1})"):
            planes = decode(self.data[slice(*self.ends[number : number + 2])].data, last - first, self.shape[1])
        planes.setflags(write=False)
        return planes


class CompactPlanes:
    """The planes [T, B] of a compact file, indexed like an array; an index decodes the blocks that it touches.

    `sizes` are the bytes of each block. Build with `open`. Of a `part`, `block` and `blocks` are the whole file's.
    """

    dtype, ndim = np.dtype(np.uint8), 2

    def __init__(self, path: Path, shape: tuple[int, int], block_planes: int, sizes: tuple[int, ...]):
        self.path, self.shape, self.block_planes = path, shape, block_planes
        self.nbytes = shape[0] * shape[1]
        self.blocks = len(sizes)
        data = np.memmap(path, dtype=np.uint8, mode="r")
        self._stored = _Blocks(path, data, (0, *itertools.accumulate(sizes)), block_planes, shape)
        self._kept = functools.lru_cache(KEPT_BLOCKS)(self._stored.decoded)
        self._first = 0  # plane of the file at which these begin

    @classmethod
    def open(cls, path: Path, shape: tuple[int, int], block_planes: int, sizes: tuple[int, ...]) -> CompactPlanes:
        """Map `path`; raises BadRecordingError where it is missing or has another length than its blocks."""
        with BadRecordingError.reading(path, "verify the recording"):
            found = path.stat().st_size
        if found != sum(sizes) or not found:
            raise BadRecordingError(f"found {found} bytes", f"{sum(sizes)}", "verify the recording", where=path)
        with BadRecordingError.reading(path, "verify the recording"):
            return cls(path, shape, block_planes, sizes)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: Any) -> Any:
        """Return what an array of all planes has there: a plane, or a new or read-only array of planes."""
        rows, *rest = index if isinstance(index, tuple) else (index,)
        if not isinstance(rows, slice):
            plane = range(len(self))[rows]
            return self._planes(plane, plane + 1)[(0, *rest)]
        wanted = range(len(self))[rows]
        if not wanted:
            return np.empty((0, self.shape[1]), dtype=np.uint8)[(slice(None), *rest)]
        first, last = min(wanted[0], wanted[-1]), max(wanted[0], wanted[-1]) + 1
        inside = self._planes(first, last)
        return (inside if wanted.step == 1 else inside[:: wanted.step])[(slice(None), *rest)]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray:
        """Return all planes, decoded."""
        found = self[:]
        return found.astype(dtype) if dtype not in (None, self.dtype) else found.copy() if copy else found

    def part(self, first: int, last: int) -> CompactPlanes:
        """Return planes [first, last) as planes of their own, of which nothing is decoded yet."""
        part = copy.copy(self)
        part._first, part.shape = self._first + first, (last - first, self.shape[1])
        part.nbytes = part.shape[0] * part.shape[1]
        return part

    def spans(self, first: int, last: int) -> Iterator[tuple[int, int]]:
        """Yield planes [first, last) in pieces that lie in one block each."""
        while first < last:
            block = (self._first + first) // self.block_planes
            end = min(last, (block + 1) * self.block_planes - self._first)
            yield first, end
            first = end

    def block(self, number: int) -> Bytes:
        """Decode a block anew; raises BadRecordingError, naming file and block, where it is damaged."""
        return self._stored.decoded(number)

    def _planes(self, first: int, last: int) -> Bytes:
        parts = []
        for start, end in self.spans(first, last):
            number = (self._first + start) // self.block_planes
            before = number * self.block_planes - self._first
            parts.append(self._kept(number)[start - before : end - before])
        return parts[0] if len(parts) == 1 else np.concatenate(parts)
