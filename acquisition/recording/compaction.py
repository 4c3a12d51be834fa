"""Makes the `.dat` files of a recording compact, and back, so that a kill at any moment leaves it whole.

One camera after another: the other form is written aside, flushed, read back against the recorded digests and renamed;
then the manifest names it; only then the form before it is removed. Until the manifest is renamed the recording is the
old one, and what lies beside it is removed by the next call.
"""

import contextlib
import dataclasses
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from acquisition.durable import flush, made_aside, write_durably
from acquisition.errors import BadRecordingError, DiskError
from acquisition.progress import Progress, silent
from acquisition.recording.digests import digests_of, planes_digests
from acquisition.recording.manifest import MANIFEST_FILE, RIG_FILE, CameraFile, Compact, Manifest, dump_manifest
from acquisition.recording.reader import compact_planes, read_manifest
from acquisition.recording.verify import verify
from acquisition.recording.writer import MARGIN_BYTES, free_bytes, lock_folder, partial_of
from acquisition.spikes.compact import SUFFIX, CompactPlanes, block_planes_of, encode
from acquisition.spikes.stream import SpikeStream

LEAST_RATIO = 2.0  # real and simulated recordings shrink to less than half; room for that is asked for at the start
MOST_THREADS = 8  # each has a block in hand, in four forms
_VERIFIED = 0.25  # share of the work that verification takes
_Item = TypeVar("_Item")
_Made = TypeVar("_Made")
_Report = Callable[[float], None]  # takes the share of one camera's work that is done


def compact(path: Path, progress: Progress = silent) -> Manifest:
    """Verify the recording `path` and make its files compact; one that was interrupted is finished.

    Raises BadRecordingError where it is no finished recording, damaged, worked on or compact already, and DiskError
    where the disk has no room for the largest file beside its original.
    """
    with _held(path):
        manifest, left = _sound(path, progress)
        plain = [camera for camera in manifest.cameras if camera.planes and not camera.compact]
        if not plain and not left:
            raise BadRecordingError("found it compact already", "`.dat` files", "leave it, or --undo", where=path)
        _require_room(path, max((int(camera.bytes / LEAST_RATIO) for camera in plain), default=0))
        return _converted(path, manifest, plain, _compacted, progress)


def restore(path: Path, progress: Progress = silent) -> Manifest:
    """Verify the recording `path` and make `.dat` files of its compact ones; raises what `compact` raises."""
    with _held(path):
        manifest, left = _sound(path, progress)
        compacted = [camera for camera in manifest.cameras if camera.compact]
        if not compacted and not left:
            raise BadRecordingError("found no compact file", "one at least", "leave it as it is", where=path)
        growth = sum(camera.bytes - camera.stored_bytes for camera in compacted)
        _require_room(path, growth + max((camera.stored_bytes for camera in compacted), default=0))
        return _converted(path, manifest, compacted, _restored, progress)


@contextlib.contextmanager
def _held(path: Path) -> Iterator[None]:
    """Keep the recording from a second call; raises BadRecordingError where there is none, or it is worked on."""
    partial = partial_of(path)
    if not path.is_dir() and partial.is_dir():
        os.close(lock_folder(partial, do="wait until that has ended"))
        raise BadRecordingError(f"found only {partial.name}", "a finished recording", "`finalise` it", where=path)
    read_manifest(path)
    handle = lock_folder(path, "is being made compact or plain now", "wait until that has ended")
    try:
        yield
    finally:
        os.close(handle)


def _sound(path: Path, progress: Progress) -> tuple[Manifest, bool]:
    """Verify the recording; return its manifest, and whether an interrupted call left something, which is removed."""
    damages = verify(path, lambda fraction, message: progress(_VERIFIED * fraction, message))
    if damages:
        more = f" and {len(damages) - 1} more" if damages[1:] else ""
        raise BadRecordingError(f"found it damaged: {damages[0]}{more}", "a sound recording", "verify it", where=path)
    manifest = read_manifest(path)
    _require_own_names(path, manifest)
    left = list(_left_over(path, manifest))
    for file in left:
        file.unlink()
    if left:
        flush(path)
    return manifest, bool(left)


def _left_over(path: Path, manifest: Manifest) -> Iterator[Path]:
    """Yield the files of an interrupted call, which the manifest does not name."""
    stored = {camera.stored_file for camera in manifest.cameras}
    made = {name for camera in manifest.cameras for name in (camera.file, _compact_name(camera))}
    for file in path.iterdir():
        aside = file.name.startswith(".") and file.name.endswith(".partial")
        if file.is_file() and file.name not in stored and (aside or file.name in made):
            yield file


def _compact_name(camera: CameraFile) -> str:
    return f"{camera.id}{SUFFIX}"


def _require_own_names(path: Path, manifest: Manifest) -> None:
    """Refuse a recording in which a file of one camera would be taken for that of another."""
    names = [camera.file for camera in manifest.cameras] + [_compact_name(camera) for camera in manifest.cameras]
    others = {*manifest.pixels_sha256, MANIFEST_FILE, RIG_FILE}
    twice = sorted({name for name in names if names.count(name) > 1 or name in others})
    if twice:
        raise BadRecordingError(f"found {twice[0]} for two things", "a file of its own for each camera", where=path)


def _require_room(path: Path, needed: int) -> None:
    free, needed = free_bytes(path), needed + 2 * (path / MANIFEST_FILE).stat().st_size  # beside the one that is there
    if free < needed + MARGIN_BYTES:
        raise DiskError(f"found {free} bytes free", f"at least {needed + MARGIN_BYTES}", "free some space", where=path)


def _converted(
    path: Path,
    manifest: Manifest,
    cameras: list[CameraFile],
    convert: Callable[[Path, CameraFile, Executor, _Report], CameraFile],
    progress: Progress,
) -> Manifest:
    """Bring `cameras` into the other form, one after another, and return the manifest that names it."""
    total, done = sum(camera.bytes for camera in cameras), 0
    with ThreadPoolExecutor(_threads()) as pool:
        for camera in cameras:

            def report(share: float, camera: CameraFile = camera, done: int = done) -> None:
                progress(_VERIFIED + (1 - _VERIFIED) * (done + share * camera.bytes) / total, camera.id)

            manifest = _named(path, manifest, convert(path, camera, pool, report))
            (path / camera.stored_file).unlink()
            flush(path)
            done += camera.bytes
    progress(1.0, f"{len(cameras)} files")
    return manifest


def _named(path: Path, manifest: Manifest, made: CameraFile) -> Manifest:
    """Write and return the manifest with the entry `made` of one camera: from here on the recording is the new one."""
    flush(path)
    entries = tuple(made if camera.id == made.id else camera for camera in manifest.cameras)
    manifest = dataclasses.replace(manifest, cameras=entries)
    write_durably(path / MANIFEST_FILE, dump_manifest(manifest))
    flush(path)
    return manifest


def _compacted(path: Path, camera: CameraFile, pool: Executor, report: _Report) -> CameraFile:
    """Write the compact file of a camera and prove it; return the entry that names it."""
    planes = SpikeStream.open(path / camera.file, camera.layout, 1.0).packed
    step, sizes = block_planes_of(camera.layout.plane_bytes), []
    firsts = range(0, len(planes), step)
    with made_aside(path / _compact_name(camera)) as aside:
        with aside.open("wb") as file:
            for block in _in_order(pool, lambda first: encode(planes[first : first + step]), firsts, report):
                sizes.append(file.write(block))
        _to_the_disk(aside)
        made = CompactPlanes.open(aside, (len(planes), planes.shape[1]), step, tuple(sizes))
        blocks = _in_order(pool, made.block, range(made.blocks), lambda _: None)  # a tenth of the work
        sha256, digests = planes_digests(blocks, camera.block_planes, camera.layout.plane_bytes)
        _require_same(camera, sha256, digests, aside)
    return dataclasses.replace(camera, sha256=sha256, compact=Compact(_compact_name(camera), step, tuple(sizes)))


def _restored(path: Path, camera: CameraFile, pool: Executor, report: _Report) -> CameraFile:
    """Write the `.dat` of a camera and prove it; return the entry that names it."""
    planes = compact_planes(path, camera)
    with made_aside(path / camera.file) as aside:
        with aside.open("wb") as file:
            for block in _in_order(pool, planes.block, range(planes.blocks), report):
                file.write(block.data)
        _to_the_disk(aside)
        _require_same(camera, *digests_of(aside, camera.block_planes * camera.layout.plane_bytes), aside)
    return dataclasses.replace(camera, compact=None)


def _in_order(
    pool: Executor, work: Callable[[_Item], _Made], items: Sequence[_Item], report: _Report
) -> Iterator[_Made]:
    """Yield what `work` makes of each item, with a few at work ahead."""
    ahead: deque[Future[_Made]] = deque()
    for number, item in enumerate(items):
        report(number / len(items))
        ahead.append(pool.submit(work, item))
        if len(ahead) > _threads():
            yield ahead.popleft().result()
    while ahead:
        yield ahead.popleft().result()


def _threads() -> int:
    return min(MOST_THREADS, len(os.sched_getaffinity(0)))


def _to_the_disk(path: Path) -> None:
    """Flush a file and forget it, so that reading it back reads the disk."""
    flush(path)
    handle = os.open(path, os.O_RDONLY)
    try:
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
    finally:
        os.close(handle)


def _require_same(camera: CameraFile, sha256: str, digests: tuple[str, ...], path: Path) -> None:
    if digests != camera.block_digests or camera.sha256 not in (None, sha256):
        found = "found that it does not read back as it was written"
        raise DiskError(found, do="nothing was changed; check the disk", where=f"{camera.id}: {path.name}")
