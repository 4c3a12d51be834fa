"""Makes a recording from the files of a killed recorder: the blocks that its journals prove, and no more."""

import dataclasses
import functools
import hashlib
import os
import shutil
from pathlib import Path
from typing import NamedTuple

import xxhash

from acquisition.durable import write_durably
from acquisition.errors import BadRecordingError
from acquisition.progress import Progress, part, silent
from acquisition.recording.digests import digests_of
from acquisition.recording.journal import SUFFIX, read_journal
from acquisition.recording.losses import clip_gaps
from acquisition.recording.manifest import (
    MANIFEST_FILE,
    TRUTH_FOLDER,
    UNFINISHED,
    CameraFile,
    Manifest,
    dump_manifest,
)
from acquisition.recording.reader import read_any_manifest
from acquisition.recording.writer import disk_errors, lock_folder, partial_of, publish, refuse_taken

_JOURNALS = 1024  # journals whose planes stay known: lists ask for those of every failed capture
_REASON = "the recorder was killed; its journal proves what is kept"


class Finalised(NamedTuple):
    """A finished recording: where it lies, and its manifest."""

    path: Path
    manifest: Manifest


def finalise(path: Path, progress: Progress = silent) -> Finalised:
    """Finish the recording `path` (or the `.partial` folder beside it); a finished one is left as it is.

    What a crash left is cut to the whole blocks that the journal lists and whose bytes have the listed digests. It gets
    its SHA-256, is marked incomplete, and takes its name. A finished recording without SHA-256 gets them.
    Raises BadRecordingError where there is no recording, no whole block in it, or it is being recorded now.
    """
    if path.suffix == ".partial":
        path = path.with_suffix("")
        refuse_taken(path)
    folder = partial_of(path)
    if path.is_dir() and any(path.iterdir()):
        return _complete(path, progress)
    if not folder.is_dir():
        raise BadRecordingError(f"found no recording and no {folder.name}", "what `record` wrote", where=path)
    lock = lock_folder(folder)
    try:
        manifest = read_any_manifest(folder)
        if manifest.status in UNFINISHED:
            manifest = _repair(folder, manifest, progress)
        publish(folder, path)
    finally:
        os.close(lock)
    progress(1.0, f"{len(manifest.cameras)} files")
    return Finalised(path, manifest)


def left_planes(path: Path) -> int | None:
    """Return the planes that `finalise` could keep of a recorder that was killed; None where it left nothing.

    These are the planes of the camera that has most in its journal, at the moment also of one at work. One that was
    killed between its finished manifest and the recording's name has all planes of the manifest.
    """
    folder = partial_of(path)
    if not folder.is_dir():
        return None
    try:
        manifest = read_any_manifest(folder)
    except BadRecordingError:
        return 0
    if manifest.status not in UNFINISHED:
        return max(camera.planes for camera in manifest.cameras)
    return max(_journalled(folder / camera.file, camera.block_planes) for camera in manifest.cameras)


def _journalled(file: Path, block_planes: int) -> int:
    """Return the planes of a `.dat` that its journal lists, read again only where it has grown."""
    journal = file.with_suffix(SUFFIX)
    try:
        stat = journal.stat()
    except OSError:
        return 0
    return _planes_listed(journal, block_planes, (stat.st_ino, stat.st_mtime_ns, stat.st_size))


@functools.lru_cache(_JOURNALS)
def _planes_listed(journal: Path, block_planes: int, stamp: tuple[int, ...]) -> int:
    return read_journal(journal, block_planes).planes


def _complete(path: Path, progress: Progress) -> Finalised:
    manifest = read_any_manifest(path)
    if manifest.status in UNFINISHED:
        expected = f"that only in {partial_of(path).name}"
        raise BadRecordingError(f"found it {manifest.status}", expected, "move it there", where=path)
    bare = [camera for camera in manifest.cameras if camera.sha256 is None]
    if not bare:
        return Finalised(path, manifest)
    cameras = []
    for number, camera in enumerate(manifest.cameras):
        progress(number / len(manifest.cameras), camera.file)
        if camera in bare:
            own = part(progress, number / len(manifest.cameras), (number + 1) / len(manifest.cameras))
            block_bytes = camera.block_planes * camera.layout.plane_bytes
            sha256, digests = digests_of(path / camera.file, block_bytes, progress=own)
            if digests != camera.block_digests:
                found = "found other bytes than were recorded"
                raise BadRecordingError(found, do="verify it", where=path / camera.file)
            camera = dataclasses.replace(camera, sha256=sha256)
        cameras.append(camera)
    manifest = dataclasses.replace(manifest, cameras=tuple(cameras))
    write_durably(path / MANIFEST_FILE, dump_manifest(manifest))
    return Finalised(path, manifest)


def _repair(folder: Path, manifest: Manifest, progress: Progress) -> Manifest:
    """Write the manifest of the blocks that the journals prove into `folder`, and cut its files to it."""
    cameras = []
    for number, camera in enumerate(manifest.cameras):
        own = part(progress, number / len(manifest.cameras), (number + 1) / len(manifest.cameras))
        cameras.append(_prove(folder, camera, own))
    if not any(camera.planes for camera in cameras):
        raise BadRecordingError("found no whole block in its journals", "one", "remove the folder", where=folder)
    with disk_errors(folder):
        for camera in cameras:
            os.truncate(folder / camera.file, camera.planes * camera.layout.plane_bytes)
        if (folder / TRUTH_FOLDER).exists():  # it is written after the planes, so it was not whole
            shutil.rmtree(folder / TRUTH_FOLDER)
        for aside in folder.glob(".*.partial"):
            aside.unlink()
    manifest = dataclasses.replace(manifest, cameras=tuple(cameras), status="incomplete", reason=_REASON)
    write_durably(folder / MANIFEST_FILE, dump_manifest(manifest))
    return manifest


def _prove(folder: Path, camera: CameraFile, progress: Progress) -> CameraFile:
    """Return the entry of the blocks from the first on that are whole and are on the disk as the journal says."""
    path = folder / camera.file
    journalled = read_journal(path.with_suffix(SUFFIX), camera.block_planes)
    plane_bytes = camera.layout.plane_bytes
    sha256, sound, planes = hashlib.sha256(), 0, 0
    progress(0.0, camera.file)
    with BadRecordingError.reading(path), path.open("rb") as file:
        for digest in journalled.digests:
            wanted = min(camera.block_planes, journalled.planes - planes)
            data = file.read(wanted * plane_bytes)
            if len(data) < wanted * plane_bytes or xxhash.xxh3_64_hexdigest(data) != digest:
                break
            sha256.update(data)
            sound, planes = sound + 1, planes + wanted
            progress(planes / journalled.planes, camera.file)
    return dataclasses.replace(
        camera,
        planes=planes,
        block_digests=journalled.digests[:sound],
        sha256=sha256.hexdigest(),
        gaps=clip_gaps(journalled.gaps, planes),
        skew_s=journalled.skew_s,
    )
