"""One camera's `.dat` in the making: a ring of chunks, digests, losses, and the thread that writes."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import DiskError
from acquisition.recording.chunk_writer import ChunkWriter, StreamSpace
from acquisition.recording.digests import BlockDigests, digests_of
from acquisition.recording.losses import Losses
from acquisition.recording.manifest import CameraFile, Gap, Layer, block_planes_of
from acquisition.recording.ring import ChunkRing
from acquisition.spikes.layout import PlaneLayout

MAX_CHUNK_BYTES, MIN_CHUNK_BYTES = 1 << 20, 1 << 16


class StreamWriter:
    """Takes planes in order from one thread, hashes them, and has another thread write them."""

    def __init__(self, folder: Path, camera_id: str, layout: PlaneLayout, space: StreamSpace | None = None):
        self.camera_id, self.layout = camera_id, layout
        self.path = folder / f"{camera_id}.dat"
        self.block_planes = block_planes_of(layout)
        self.damage: str | None = None  # what closing or reading back has found
        self.clock: dict[str, Any] | None = None  # what sync pulses told of the camera's clock
        self.skew_s: float | None = None  # by how much the planes come late in the middle of the recording
        self.device: dict[str, Any] | None = None  # what the camera said of itself
        self._unlisted = 0  # planes behind the end of a file that could not be stretched
        self._closed = False
        space, self._block_bytes = space or StreamSpace(), self.block_planes * layout.plane_bytes
        self.ring = _ring_for(self._block_bytes, space.ring_bytes)
        self._losses = Losses()
        self._digests = BlockDigests(self.block_planes, layout.plane_bytes, self._promise_block)
        self.disk = ChunkWriter(self.path, self.ring, space, layout.plane_bytes)

    @property
    def planes(self) -> int:
        """All planes taken, lost ones included."""
        return self._digests.planes

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """The planes lost so far."""
        return tuple(self._losses.gaps)

    @property
    def failure(self) -> OSError | None:
        """The error with which the disk refused a write."""
        return self.disk.failure

    @property
    def refusing(self) -> Layer:
        """The layer that loses planes when the ring takes none."""
        return "disk" if self.failure else "ring"

    def offer(self, packed: NDArray[np.uint8]) -> bool:
        """Take planes [n, B] without waiting; False, and nothing is taken, where the ring has no room for them all."""
        data = np.ascontiguousarray(packed)
        if not self.ring.offer(data.reshape(-1)):
            return False
        self._digests.add(data)
        return True

    def append(self, packed: NDArray[np.uint8]) -> None:
        """Take planes [n, B], waiting for the disk; raises DiskError when it refused something."""
        data = np.ascontiguousarray(packed)
        if not self.ring.put(data.reshape(-1)):
            raise self.disk_error()
        self._digests.add(data)

    def append_lost(self, gaps: list[Gap]) -> None:
        """List planes that were lost; they read as zeros. Never waits."""
        for gap in gaps:
            self._losses.add(gap)
            self.disk.promise(self.ring.position, {"gap": [gap.first_plane, gap.planes, gap.layer]})
            self.ring.skip(gap.planes * self.layout.plane_bytes)
            self._digests.add_zeros(gap.planes)

    def close(self) -> None:
        """Put what was taken on the disk; raises DiskError when it refused something."""
        self._finish(stretch=False)
        if self.failure:
            raise self.disk_error()

    def close_keeping(self) -> None:
        """Close as `close` does, but keep the file: planes that the disk refused are lost in the layer `disk`.

        Where the disk does not promise to keep the file, `damage` says so.
        """
        try:
            self._finish(stretch=True)
        except DiskError as error:
            self.damage = f"{self.path.name}: {error.found}"

    def abandon(self) -> None:
        """Close a file that will be removed, if it is still open."""
        self.ring.close()
        self.disk.join()
        self.disk.abandon()

    def disk_error(self) -> DiskError:
        """Return what the disk refused as an error."""
        found = self.failure.strerror if self.failure else "the file is closed"
        lost = f", {self._unlisted} planes behind the file's end are lost" if self._unlisted else ""
        do = "free some space and record again"
        return DiskError(f"the disk is full or failing ({found}){lost}", do=do, where=self.path)

    def draft(self) -> CameraFile:
        """Return the manifest's entry of a stream whose planes are only in the journal."""
        return CameraFile(self.camera_id, self.path.name, self.layout, 0, 0, self.block_planes, (), None)

    def entry(self) -> CameraFile:
        """Return the manifest's entry for the planes written, read back from the closed file for its SHA-256.

        Blocks that the disk refused in part get the digest of the bytes that are there.
        """
        sha256, found = digests_of(self.path, self._block_bytes)
        digests = self._digests.digests
        changed = [n for n, pair in enumerate(zip(digests, found, strict=False)) if pair[0] != pair[1]]
        if changed:
            self.damage = f"{self.path.name}: block {changed[0]} does not read back as it was written"
        return CameraFile(
            *(self.camera_id, self.path.name, self.layout, self.planes, 0, self.block_planes),
            block_digests=(*digests, *found[len(digests) :]),
            sha256=sha256,
            gaps=self.gaps,
            skew_s=self.skew_s,
            skew_sd_s=None if self.skew_s is None else (self.clock or {}).get("skew_sd_s"),
            clock=self.clock,
            device=self.device,
        )

    def _promise_block(self, number: int, planes: int, digest: str) -> None:
        record = {"block": number, "planes": planes, "xxh3": digest}
        self.disk.promise(self.planes * self.layout.plane_bytes, record)

    def _finish(self, *, stretch: bool) -> None:
        if self._closed:
            return
        self._closed = True
        self._digests.finish()
        self.ring.close()
        self.disk.join()
        try:
            if self.failure and stretch:
                self._list_refused()
            self.disk.finish(self.planes * self.layout.plane_bytes)
        except OSError as error:
            self.disk.failure = error
            raise self.disk_error() from error
        finally:
            self.disk.abandon()

    def _list_refused(self) -> None:
        """Make zeros of everything from the first refused plane on, and list it as lost."""
        plane_bytes = self.layout.plane_bytes
        kept = self.disk.written // plane_bytes
        self._digests.keep(kept)
        self.disk.file.cut(kept * plane_bytes)
        try:
            self.disk.file.cut(self.planes * plane_bytes)
        except OSError:  # it may not even be that long: what is behind it cannot be listed
            self._unlisted, self._digests.planes = self.planes - kept, kept
            self._losses.clip(kept)
        else:
            self._losses.refuse(kept, self.planes)


def _ring_for(block_bytes: int, ring_bytes: int) -> ChunkRing:
    """Return a ring of chunks about as large as a block, with room for one block more than is being written."""
    chunk_bytes = min(max(1 << (block_bytes - 1).bit_length(), MIN_CHUNK_BYTES), MAX_CHUNK_BYTES)
    return ChunkRing(max(ring_bytes // chunk_bytes, block_bytes // chunk_bytes + 3), chunk_bytes)
