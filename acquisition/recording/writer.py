"""Writes a recording aside, under `REC.partial`, and gives it its name when all of it is on the disk."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import importlib.metadata
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import xxhash
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError, DiskError
from acquisition.recording.manifest import (
    MANIFEST_FILE,
    RIG_FILE,
    CameraFile,
    Gap,
    Manifest,
    Trigger,
    block_planes_of,
    dump_manifest,
)
from acquisition.spikes.layout import PlaneLayout
from rigs.rig import Rig
from rigs.toml import dump_rig

_MARGIN_BYTES = 1 << 20  # the manifest and the rig
_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class StreamWriter:
    """One camera's `.dat`, written in order by one thread, hashed on the way."""

    def __init__(self, folder: Path, camera_id: str, layout: PlaneLayout):
        self.camera_id = camera_id
        self.layout = layout
        self.planes = 0
        self.skew_s: float | None = None
        self.partial_bytes = 0
        self._path = folder / f"{camera_id}.dat"
        self._file = self._path.open("xb", buffering=0)
        self._sha256 = hashlib.sha256()
        self._block = xxhash.xxh3_64()
        self._digests: list[str] = []
        self._gaps: list[Gap] = []

    def append(self, packed: NDArray[np.uint8]) -> None:
        """Write planes [n, B]; raises DiskError when the disk is full."""
        if not len(packed):
            return
        block_planes = block_planes_of(self.layout)
        data = np.ascontiguousarray(packed)
        with disk_errors(self._path):
            left = data.data.cast("B")
            while left:
                left = left[self._file.write(left) or 0 :]
        self._sha256.update(data.data)
        while len(data):
            part = data[: block_planes - self.planes % block_planes]
            self._block.update(part.data)
            self.planes += len(part)
            data = data[len(part) :]
            if self.planes % block_planes == 0:
                self._end_block()

    def append_lost(self, gaps: list[Gap]) -> None:
        """Write zeros for planes that were lost, and list them."""
        for gap in gaps:
            for start in range(0, gap.planes, block_planes_of(self.layout)):
                count = min(block_planes_of(self.layout), gap.planes - start)
                self.append(np.zeros((count, self.layout.plane_bytes), dtype=np.uint8))
            self._gaps.append(gap)

    def close(self) -> None:
        """Put what was written on the disk."""
        with disk_errors(self._path), self._file:
            os.fsync(self._file.fileno())

    def abandon(self) -> None:
        """Close a file that will be removed, if it is still open."""
        self._file.close()

    def entry(self) -> CameraFile:
        """The manifest's entry of what was written."""
        if self.planes % block_planes_of(self.layout):
            self._end_block()
        return CameraFile(
            id=self.camera_id,
            file=self._path.name,
            layout=self.layout,
            planes=self.planes,
            first_tick=0,
            block_planes=block_planes_of(self.layout),
            block_digests=tuple(self._digests),
            sha256=self._sha256.hexdigest(),
            gaps=tuple(self._gaps),
            skew_s=self.skew_s,
            partial_bytes=self.partial_bytes,
        )

    def _end_block(self) -> None:
        self._digests.append(self._block.hexdigest())
        self._block.reset()


class RecordingWriter:
    """A recording in the making; use as a context: what is not committed when it ends is removed.

    Raises BadRecordingError where `path` is taken, DiskError where `needed_bytes` are not free.
    """

    def __init__(self, path: Path, rig: Rig, needed_bytes: int):
        self.path = path
        self.rig = rig
        self.folder = path.parent / f"{path.name}.partial"  # where the files lie until `commit`
        self._needed_bytes = needed_bytes + _MARGIN_BYTES
        self._lock = -1
        self._streams: list[StreamWriter] = []

    def __enter__(self) -> RecordingWriter:
        refuse_taken(self.path)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        free = free_bytes(self.path.parent)
        if free < self._needed_bytes:
            raise DiskError(
                f"{self.path}: found {free} bytes free, expected at least {self._needed_bytes}; "
                "free some space or record fewer ticks"
            )
        self.folder.mkdir(exist_ok=True)
        self._lock = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(self._lock)
            raise BadRecordingError(f"{self.folder}: is being recorded now; choose another --out") from error
        for left_over in self.folder.iterdir():  # of a writer that was killed
            shutil.rmtree(left_over) if left_over.is_dir() else left_over.unlink()
        return self

    def __exit__(self, *_: object) -> None:
        for stream in self._streams:
            stream.abandon()
        if self.folder.exists():
            shutil.rmtree(self.folder)
        os.close(self._lock)

    def stream(self, camera_id: str, layout: PlaneLayout) -> StreamWriter:
        """The writer of one camera's file."""
        with disk_errors(self.folder):
            self._streams.append(StreamWriter(self.folder, camera_id, layout))
        return self._streams[-1]

    def commit(self, cameras: list[CameraFile], trigger: Trigger) -> Manifest:
        """Write manifest and rig, bring everything to the disk, and give the recording its name."""
        rig_text = dump_rig(self.rig)
        writer = f"spike4dgs {importlib.metadata.version('spike4dgs')}"
        rig_sha256 = hashlib.sha256(rig_text.encode()).hexdigest()
        manifest = Manifest(self.rig.tick_rate_hz, trigger, writer, rig_sha256, tuple(cameras))
        with disk_errors(self.folder):
            for pixels in {camera.pixels for camera in self.rig.cameras if camera.pixels}:
                shutil.copyfile(pixels, self.folder / pixels.name)
            (self.folder / RIG_FILE).write_text(rig_text, encoding="utf-8")
            (self.folder / MANIFEST_FILE).write_text(dump_manifest(manifest), encoding="utf-8")
            for path in (*self.folder.rglob("*"), self.folder):
                _sync(path)
            refuse_taken(self.path)
            self.folder.rename(self.path)
            _sync(self.path.parent)
        return manifest


def refuse_taken(path: Path) -> None:
    """Raise BadRecordingError unless `path` is free or an empty folder."""
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise BadRecordingError(f"{path}: exists already, expected a new folder; choose another --out")


def free_bytes(folder: Path) -> int:
    """What the disk of `folder` has left for this user."""
    return shutil.disk_usage(folder).free


@contextlib.contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """A full disk becomes a DiskError that names `path`."""
    try:
        yield
    except OSError as error:
        if error.errno not in _DISK_FULL:
            raise
        raise DiskError(f"{path}: the disk is full ({error.strerror}); free some space and record again") from error


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
