"""Writes a recording aside, under `REC.partial`, and gives it its name when all of it is on the disk."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import fcntl
import functools
import hashlib
import importlib.metadata
import logging
import os
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Literal

from acquisition.durable import flush, write_durably
from acquisition.errors import BadRecordingError, DiskError
from acquisition.recording.chunk_writer import RING_BYTES, StreamSpace
from acquisition.recording.flusher import Flusher
from acquisition.recording.journal import SUFFIX
from acquisition.recording.manifest import (
    MANIFEST_FILE,
    RIG_FILE,
    CameraFile,
    Manifest,
    Trigger,
    dump_manifest,
    note_bytes,
)
from acquisition.recording.stream_writer import StreamWriter
from acquisition.spikes.layout import PlaneLayout
from rigs.rig import Rig
from rigs.toml import dump_rig

MARGIN_BYTES = 1 << 20  # the rig, and what a manifest says of no block
_LOG = logging.getLogger(__name__)
_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@dataclasses.dataclass(frozen=True)
class DiskUse:
    """Limits on the disk and the memory that a recording may take.

    `needed_bytes` must be free at the start, beside the `keep_free_bytes` that are left free at the end. `ring_bytes`
    is the memory between each camera and its file. `replace_left_over` deletes what a killed writer left behind.
    """

    needed_bytes: int = 0
    keep_free_bytes: int = MARGIN_BYTES
    ring_bytes: int = RING_BYTES
    replace_left_over: bool = True


class RecordingWriter:
    """A recording in the making; use it as a context, which removes what is not committed when it ends.

    What real cameras saw stays in `folder`: where `use` replaces no left-over, planes that journals list are kept.
    Raises BadRecordingError where `path` is taken, DiskError where `use` does not fit the disk. `full` is the reason
    why the disk guard took no more of the disk. With `problems` the recording is committed as incomplete, for these
    reasons.
    """

    def __init__(self, path: Path, rig: Rig, use: DiskUse | int = 0):
        self.path = path
        self.rig = rig
        self.folder = partial_of(path)  # where the files lie until `commit`
        self.full: str | None = None
        self.problems: list[str] = []
        self.trigger_plane: int | None = None
        self.first_plane = 0  # as the cameras count: how many came before the recording
        self._use = use if isinstance(use, DiskUse) else DiskUse(use)
        self._lock = -1
        self._streams: list[StreamWriter] = []
        self._flusher = Flusher(self.folder, "*.dat", f"*{SUFFIX}")

    def __enter__(self) -> RecordingWriter:
        refuse_taken(self.path)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        free, needed = free_bytes(self.path.parent), self._use.needed_bytes + self._use.keep_free_bytes
        if free < needed:
            do = "free some space or record fewer ticks"
            raise DiskError(f"found {free} bytes free", f"at least {needed}", do, where=self.path)
        self.folder.mkdir(exist_ok=True)
        self._lock = lock_folder(self.folder)
        self._refuse_left_over()
        for left_over in self.folder.iterdir():  # of a writer that was killed
            shutil.rmtree(left_over) if left_over.is_dir() else left_over.unlink()
        flush(self.folder.parent)
        self._flusher.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        for stream in self._streams:
            stream.abandon()
        self._flusher.__exit__()
        if self.folder.exists() and not self._use.replace_left_over and self._taken():
            _LOG.warning("%s keeps what was recorded; `spike4dgs finalise %s` saves it", self.folder, self.path)
        elif self.folder.exists():
            shutil.rmtree(self.folder)
        os.close(self._lock)

    def stream(self, camera_id: str, layout: PlaneLayout, planes: int | None = None) -> StreamWriter:
        """Return the writer of one camera's file, with room for `planes` planes where their number is known."""
        space = StreamSpace(self._use.ring_bytes, planes, self._allows)
        with disk_errors(self.folder):
            self._streams.append(StreamWriter(self.folder, camera_id, layout, space))
        return self._streams[-1]

    def mark(self, status: Literal["armed", "recording"], trigger: Trigger) -> None:
        """Write the rig, and a manifest that says the cameras are armed or planes are being recorded."""
        drafts = tuple(stream.draft() for stream in self._streams)
        self._write(Manifest(**self._fields(trigger), cameras=drafts, status=status))

    def commit(self, cameras: list[CameraFile], trigger: Trigger) -> Manifest:
        """Write manifest and rig, bring everything to the disk, and give the recording its name."""
        self.problems += [stream.damage for stream in self._streams if stream.damage]
        if self._flusher.failure is not None:
            self.problems.append(f"the disk refused to keep what was written ({self._flusher.failure.strerror})")
        manifest = Manifest(
            **self._fields(trigger),
            cameras=tuple(cameras),
            status="incomplete" if self.problems else "complete",
            reason="; ".join(self.problems) or None,
            trigger_plane=self.trigger_plane,
        )
        self._write(manifest)
        publish(self.folder, self.path)
        return manifest

    def entries(self) -> list[CameraFile]:
        """Return the entries of all streams, which are closed; their files are read back side by side."""
        with ThreadPoolExecutor(min(len(self._streams), len(os.sched_getaffinity(0)))) as pool:
            return list(pool.map(StreamWriter.entry, self._streams))

    def _fields(self, trigger: Trigger) -> dict:
        return {
            "tick_rate_hz": self.rig.tick_rate_hz,
            "trigger": trigger,
            "writer": f"spike4dgs {importlib.metadata.version('spike4dgs')}",
            "rig_sha256": hashlib.sha256(dump_rig(self.rig).encode()).hexdigest(),
            "pixels_sha256": {pixels.name: sha256 for pixels, sha256 in self._pixels.items()},
            "direct_io": all(stream.disk.file.direct for stream in self._streams),
        }

    @functools.cached_property
    def _pixels(self) -> dict[Path, str]:
        """The SHA-256 of each pixel calibration the rig names; raises BadRecordingError for one that is not there."""
        found = {}
        for pixels in {camera.pixels for camera in self.rig.cameras if camera.pixels}:
            with BadRecordingError.reading(pixels, "calibrate again"):
                found[pixels] = hashlib.sha256(pixels.read_bytes()).hexdigest()
        return found

    def _write(self, manifest: Manifest) -> None:
        with disk_errors(self.folder):
            for pixels in self._pixels:
                shutil.copyfile(pixels, self.folder / pixels.name)
        write_durably(self.folder / RIG_FILE, dump_rig(self.rig))
        write_durably(self.folder / MANIFEST_FILE, dump_manifest(manifest))
        flush(self.folder)

    def _allows(self, size: int) -> bool:
        """Return whether `size` more bytes leave free what is to be kept free: the disk guard."""
        free = free_bytes(self.folder)
        notes = sum(note_bytes(s.planes + size // s.layout.plane_bytes, s.layout) for s in self._streams)
        kept = self._use.keep_free_bytes
        if free - size < kept + notes and not self.full:
            self.full = f"the disk had {free} bytes free, {kept} are kept free"
        return not self.full

    def _taken(self) -> bool:
        """Return whether a journal in the folder lists planes."""
        return any(path.stat().st_size for path in self.folder.glob(f"*{SUFFIX}"))

    def _refuse_left_over(self) -> None:
        if not self._use.replace_left_over and self._taken():
            os.close(self._lock)
            do = f"save it by `spike4dgs finalise {self.path}`, or remove it"
            raise BadRecordingError("found what a killed recorder left", "nothing", do, where=self.folder)


def partial_of(path: Path) -> Path:
    """Return where the recording `path` lies until it is whole."""
    return path.parent / f"{path.name}.partial"


def lock_folder(folder: Path, held: str = "is being recorded now", do: str = "choose another --out") -> int:
    """Return a handle that holds `folder` for one writer until it is closed.

    Raises BadRecordingError if it is `held`, and says what to `do`.
    """
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(handle)
        raise BadRecordingError(held, do=do, where=folder) from error
    return handle


def publish(folder: Path, path: Path) -> None:
    """Give the whole recording in `folder` its name `path`, without its journals, and bring all to the disk."""
    with disk_errors(folder):
        refuse_taken(path)  # before the journals go, by which what was recorded could still be saved
        for journal in folder.glob(f"*{SUFFIX}"):
            journal.unlink()
        for inside in (*folder.rglob("*"), folder):
            flush(inside)
        folder.rename(path)
        flush(path.parent)


def refuse_taken(path: Path) -> None:
    """Raise BadRecordingError unless `path` is free or an empty folder."""
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise BadRecordingError("exists already", "a new folder", "choose another --out", where=path)


def free_bytes(folder: Path) -> int:
    """Return the bytes that the disk of `folder` has left for this user."""
    return shutil.disk_usage(folder).free


@contextlib.contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn the error of a full disk into a DiskError that names `path`."""
    try:
        yield
    except OSError as error:
        if error.errno not in _DISK_FULL:
            raise
        found = f"the disk is full ({error.strerror})"
        raise DiskError(found, do="free some space and record again", where=path) from error
