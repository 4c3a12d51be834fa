"""Proves that a recording is what was written, or names the file and the block that is not."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from acquisition.errors import BadRecordingError
from acquisition.progress import Progress, part, silent
from acquisition.recording.digests import digests_of, planes_digests
from acquisition.recording.manifest import RIG_FILE, CameraFile
from acquisition.recording.reader import compact_planes, read_manifest
from acquisition.spikes.compact import CompactPlanes
from acquisition.spikes.packing import Bytes


@dataclass(frozen=True)
class Damaged:
    """Damage of `file`; `block` counts its blocks from 0, None where the whole file is meant.

    They are the blocks of digests or, where the bytes of a compact file cannot be decoded, its own.
    """

    file: str
    block: int | None
    reason: str

    def __str__(self) -> str:
        where = self.file if self.block is None else f"{self.file}: block {self.block}"
        return f"{where}: {self.reason}"


def verify(path: Path, progress: Progress = silent) -> list[Damaged]:
    """Find every damage of the recording in `path`; raises BadRecordingError when it is no recording."""
    manifest = read_manifest(path)
    damages = _verify_whole(path / RIG_FILE, manifest.rig_sha256)
    for name, sha256 in sorted(manifest.pixels_sha256.items()):
        damages += _verify_whole(path / name, sha256)
    total = max(1, sum(camera.planes for camera in manifest.cameras))
    done = 0
    for camera in manifest.cameras:
        progress(done / total, camera.stored_file)
        own = part(progress, done / total, (done + camera.planes) / total)
        damages += (_verify_compact if camera.compact else _verify_stream)(path, camera, own)
        done += camera.planes
    progress(1.0, f"{len(manifest.cameras)} files")
    return damages


def _verify_whole(path: Path, sha256: str) -> list[Damaged]:
    try:
        found = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        return [Damaged(path.name, None, f"cannot be read ({error.strerror})")]
    return [] if found == sha256 else [Damaged(path.name, None, "its SHA-256 is not the recorded one")]


def _verify_stream(folder: Path, camera: CameraFile, progress: Progress) -> list[Damaged]:
    path = folder / camera.file
    try:
        size = path.stat().st_size
        sha256, found = digests_of(path, camera.block_planes * camera.layout.plane_bytes, camera.bytes, progress)
    except OSError as error:
        return [Damaged(path.name, None, f"cannot be read ({error.strerror})")]
    damages = _differing(camera, found)
    if size != camera.bytes:
        damages.append(Damaged(path.name, None, f"found {size} bytes, expected {camera.bytes}"))
    return damages or _unlike(camera, sha256)


def _verify_compact(folder: Path, camera: CameraFile, progress: Progress) -> list[Damaged]:
    """Find the blocks that cannot be decoded or, where all can, planes that are not the recorded ones."""
    damages: list[Damaged] = []

    def decoded(planes: CompactPlanes) -> Iterator[Bytes]:
        for number in range(planes.blocks):
            progress(number / planes.blocks, camera.stored_file)
            try:
                yield planes.block(number)
            except BadRecordingError as error:
                damages.append(Damaged(camera.stored_file, number, error.found))

    try:
        planes = compact_planes(folder, camera)
    except BadRecordingError as error:
        return [Damaged(camera.stored_file, None, f"{error.found}{error.expected and f', expected {error.expected}'}")]
    sha256, found = planes_digests(decoded(planes), camera.block_planes, camera.layout.plane_bytes)
    return damages or _differing(camera, found) or _unlike(camera, sha256)


def _differing(camera: CameraFile, found: tuple[str, ...]) -> list[Damaged]:
    """Return the blocks whose digests are not the recorded ones."""
    damages = []
    for block, (recorded, digest) in enumerate(zip_longest(camera.block_digests, found)):
        if recorded != digest:
            first, last = block * camera.block_planes, min((block + 1) * camera.block_planes, camera.planes) - 1
            reason = f"planes {first} to {last} are not the recorded ones"
            damages.append(Damaged(camera.stored_file, block, reason))
    return damages


def _unlike(camera: CameraFile, sha256: str) -> list[Damaged]:
    if camera.sha256 in (None, sha256):
        return []
    return [Damaged(camera.stored_file, None, "its SHA-256 is not the recorded one")]
