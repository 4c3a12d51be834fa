"""One camera's `.dat` in the making: a ring of chunks, and the one thread that writes them."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xxhash
from numpy.typing import NDArray

from acquisition.errors import DiskError
from acquisition.recording.direct import ALIGNMENT, DirectFile
from acquisition.recording.journal import SUFFIX, Journal, clip_gaps
from acquisition.recording.manifest import CameraFile, Gap, Layer, block_planes_of
from acquisition.recording.ring import Chunk, ChunkRing
from acquisition.spikes.layout import PlaneLayout

MAX_CHUNK_BYTES, MIN_CHUNK_BYTES = 1 << 20, 1 << 16
RING_BYTES = 16 << 20
RESERVE_BYTES = 64 << 20  # so much space is taken at a time where the length is not known


@dataclass(frozen=True)
class StreamSpace:
    """Where a stream's bytes wait and lie: the ring's size, the planes expected (None where nobody knows).

    `allows` is asked before more of the disk is taken than was reserved; `open_file` opens the file.
    """

    ring_bytes: int = RING_BYTES
    planes: int | None = None
    allows: Callable[[int], bool] = lambda size: True
    open_file: Callable[[Path], DirectFile] = DirectFile


class StreamWriter:
    """Takes planes in order from one thread, hashes them, and has another thread write them.

    `planes` counts all planes taken, lost ones included. What the disk refuses is in `failure`.
    """

    def __init__(self, folder: Path, camera_id: str, layout: PlaneLayout, space: StreamSpace | None = None):
        self.camera_id = camera_id
        self.layout = layout
        self.planes = 0
        self.partial_bytes = 0
        self.failure: OSError | None = None
        self.damage: str | None = None  # what `entry` found on reading back
        self.clock: dict[str, Any] | None = None  # what sync pulses told of the camera's clock
        self.device: dict[str, Any] | None = None  # what the camera said of itself
        self.path = folder / f"{camera_id}.dat"
        self.block_planes = block_planes_of(layout)
        self._skew_s: float | None = None
        self._space = space or StreamSpace()
        self._block_bytes = self.block_planes * layout.plane_bytes
        chunk_bytes = min(max(1 << (self._block_bytes - 1).bit_length(), MIN_CHUNK_BYTES), MAX_CHUNK_BYTES)
        slots = max(self._space.ring_bytes // chunk_bytes, self._block_bytes // chunk_bytes + 3)
        self._ring = ChunkRing(slots, chunk_bytes)
        self._file = self._space.open_file(self.path)
        self._journal = Journal(self.path.with_suffix(SUFFIX))
        self._written = 0  # the file's first bytes that are on the disk
        self._block = xxhash.xxh3_64()
        self._digests: list[str] = []
        self._gaps: list[Gap] = []
        self._unlisted = 0
        self._closed = False
        self._thread = threading.Thread(target=self._write_chunks, name=f"write {camera_id}", daemon=True)
        self._thread.start()

    @property
    def direct(self) -> bool:
        """Whether the file is written past the page cache."""
        return self._file.direct

    @property
    def fullness(self) -> float:
        """How full the ring is, in [0, 1]."""
        return self._ring.fullness

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """What was lost so far."""
        return tuple(self._gaps)

    @property
    def skew_s(self) -> float | None:
        """How far the first plane was from the trigger."""
        return self._skew_s

    @skew_s.setter
    def skew_s(self, skew_s: float | None) -> None:
        self._skew_s = skew_s
        if skew_s is not None:
            self._journal.promise(0, {"skew_s": skew_s})

    def offer(self, packed: NDArray[np.uint8]) -> bool:
        """Take planes [n, B] without waiting; False, and nothing is taken, where the ring has no room for them all."""
        data = np.ascontiguousarray(packed)
        if not self._ring.offer(data.reshape(-1)):
            return False
        self._hash(data)
        return True

    def append(self, packed: NDArray[np.uint8]) -> None:
        """Take planes [n, B], waiting for the disk; raises DiskError when it refused something."""
        data = np.ascontiguousarray(packed)
        if not self._ring.put(data.reshape(-1)):
            raise self.disk_error()
        self._hash(data)

    def append_lost(self, gaps: list[Gap]) -> None:
        """List planes that were lost; they read as zeros. Never waits."""
        for gap in gaps:
            before = self._gaps[-1] if self._gaps else None
            if before and before.layer == gap.layer and before.first_plane + before.planes == gap.first_plane:
                self._gaps[-1] = Gap(before.first_plane, before.planes + gap.planes, gap.layer)
            else:
                self._gaps.append(gap)
            record = {"gap": [gap.first_plane, gap.planes, gap.layer]}
            self._journal.promise(self._ring.position, record)
            self._ring.skip(gap.planes * self.layout.plane_bytes)
            self._hash_zeros(gap.planes)

    def close(self) -> None:
        """Put what was taken on the disk; raises DiskError when it refused something."""
        self._finish(stretch=False)
        if self.failure:
            raise self.disk_error()

    def close_keeping(self) -> None:
        """`close`, but what the disk refused is lost in the layer `disk` and the rest of the file is kept."""
        self._finish(stretch=True)

    def abandon(self) -> None:
        """Close a file that will be removed, if it is still open."""
        self._ring.close()
        self._thread.join()
        self._file.abandon()
        self._journal.close()

    def disk_error(self) -> DiskError:
        """What the disk refused, in a line."""
        found = self.failure.strerror if self.failure else "the file is closed"
        lost = f", {self._unlisted} planes behind the file's end are lost" if self._unlisted else ""
        return DiskError(
            f"the disk is full or failing ({found}){lost}", do="free some space and record again", where=self.path
        )

    def draft(self) -> CameraFile:
        """The manifest's entry of a stream whose planes are only in the journal."""
        return CameraFile(self.camera_id, self.path.name, self.layout, 0, 0, self.block_planes, (), None)

    def entry(self) -> CameraFile:
        """The manifest's entry of what was written, read back from the closed file for its SHA-256.

        Blocks that the disk refused in part get the digest of what is there.
        """
        sha256, found = digests_of(self.path, self._block_bytes)
        changed = [n for n, pair in enumerate(zip(self._digests, found, strict=False)) if pair[0] != pair[1]]
        if changed:
            self.damage = f"{self.path.name}: block {changed[0]} does not read back as it was written"
        return CameraFile(
            id=self.camera_id,
            file=self.path.name,
            layout=self.layout,
            planes=self.planes,
            first_tick=0,
            block_planes=self.block_planes,
            block_digests=(*self._digests, *found[len(self._digests) :]),
            sha256=sha256,
            gaps=self.gaps,
            skew_s=self.skew_s if self.clock is None else self.clock["skew_s"],
            skew_sd_s=None if self.clock is None else self.clock["skew_sd_s"],
            clock=self.clock,
            device=self.device,
            partial_bytes=self.partial_bytes,
        )

    def _write_chunks(self) -> None:
        while (chunk := self._ring.take()) is not None:
            try:
                self._write(chunk)
            except OSError as error:
                self.failure = error
                self._ring.refuse()
                return
            self._ring.give_back(chunk)

    def _write(self, chunk: Chunk) -> None:
        data = self._ring.data(chunk, ALIGNMENT)
        if chunk.offset + len(data) > self._file.reserved:
            self._reserve(chunk.offset + len(data))
        self._file.write(data, chunk.offset)
        self._written = chunk.offset + chunk.used
        self._journal.keep(self._written)

    def _reserve(self, size: int) -> None:
        """Take all the space a run of known length needs, or more ahead while the disk may be filled."""
        with contextlib.suppress(OSError):  # where there is no room, the write itself says so
            if self._space.planes is not None:
                self._file.reserve(max(size, self._space.planes * self.layout.plane_bytes))
            elif self._space.allows(RESERVE_BYTES):
                self._file.reserve(size + RESERVE_BYTES)

    def _hash(self, data: NDArray[np.uint8]) -> None:
        while len(data):
            part = data[: self.block_planes - self.planes % self.block_planes]
            self._block.update(part.data)
            self._count(len(part))
            data = data[len(part) :]

    def _hash_zeros(self, planes: int) -> None:
        while planes:
            part = min(planes, self.block_planes - self.planes % self.block_planes)
            if part == self.block_planes:
                self._count(part, _zeros_digest(self._block_bytes))
            else:
                self._block.update(bytes(part * self.layout.plane_bytes))
                self._count(part)
            planes -= part

    def _count(self, planes: int, digest: str | None = None) -> None:
        self.planes += planes
        if self.planes % self.block_planes == 0:
            self._end_block(self.block_planes, digest)

    def _end_block(self, planes: int, digest: str | None = None) -> None:
        digest = digest or self._block.hexdigest()
        self._block.reset()
        record = {"block": len(self._digests), "planes": planes, "xxh3": digest}
        self._journal.promise(self.planes * self.layout.plane_bytes, record)
        self._digests.append(digest)

    def _finish(self, *, stretch: bool) -> None:
        if self._closed:
            return
        self._closed = True
        if self.planes % self.block_planes:
            self._end_block(self.planes % self.block_planes)
        self._ring.close()
        self._thread.join()
        try:
            if self.failure and stretch:
                self._list_refused()
            self._file.finish(self.planes * self.layout.plane_bytes)
            if not self.failure:
                self._journal.keep(self.planes * self.layout.plane_bytes)
        except OSError as error:
            self.failure = error
            raise self.disk_error() from error
        finally:
            self._file.abandon()
            self._journal.close()

    def _list_refused(self) -> None:
        """Everything from the first refused plane on is zeros, lost in the layer `disk` unless it was lost before."""
        kept = self._written // self.layout.plane_bytes
        del self._digests[kept // self.block_planes :]
        self._file.cut(kept * self.layout.plane_bytes)
        try:
            self._file.cut(self.planes * self.layout.plane_bytes)
        except OSError:  # it may not even be that long: what is behind it cannot be listed
            self._unlisted, self.planes = self.planes - kept, kept
            self._gaps = list(clip_gaps(self._gaps, kept))
            return
        lost_before = [gap for gap in self._gaps if gap.first_plane + gap.planes > kept]
        self._gaps = list(clip_gaps(self._gaps, kept))
        at = kept
        for gap in (*lost_before, Gap(self.planes, 1, "disk")):
            first = max(gap.first_plane, at)
            if first > at:
                self._gaps.append(Gap(at, first - at, "disk"))
            at = gap.first_plane + gap.planes
            if gap.first_plane < self.planes:
                self._gaps.append(Gap(first, at - first, gap.layer))

    @property
    def refusing(self) -> Layer:
        """The layer that loses planes when the ring takes none."""
        return "disk" if self.failure else "ring"


@functools.cache
def _zeros_digest(size: int) -> str:
    return xxhash.xxh3_64_hexdigest(bytes(size))


def digests_of(path: Path, block_bytes: int) -> tuple[str, tuple[str, ...]]:
    """SHA-256 of a file and xxh3-64 of each of its blocks."""
    sha256, blocks = hashlib.sha256(), []
    with path.open("rb") as file:
        while data := file.read(block_bytes):
            sha256.update(data)
            blocks.append(xxhash.xxh3_64_hexdigest(data))
    return sha256.hexdigest(), tuple(blocks)
