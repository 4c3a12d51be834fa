"""Proves that a recording is what was written, or names the file and the block that is not."""

import hashlib
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from acquisition.progress import Progress, silent
from acquisition.recording.digests import digests_of
from acquisition.recording.manifest import RIG_FILE, CameraFile
from acquisition.recording.reader import read_manifest


@dataclass(frozen=True)
class Damaged:
    """Damage of `file`; `block` counts digest blocks from 0, None where the whole file is meant."""

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
        progress(done / total, camera.file)
        damages += _verify_stream(path / camera.file, camera)
        done += camera.planes
    progress(1.0, f"{len(manifest.cameras)} files")
    return damages


def _verify_whole(path: Path, sha256: str) -> list[Damaged]:
    try:
        found = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        return [Damaged(path.name, None, f"cannot be read ({error.strerror})")]
    return [] if found == sha256 else [Damaged(path.name, None, "its SHA-256 is not the recorded one")]


def _verify_stream(path: Path, camera: CameraFile) -> list[Damaged]:
    plane_bytes = camera.layout.plane_bytes
    try:
        size = path.stat().st_size
        sha256, found = digests_of(path, camera.block_planes * plane_bytes, camera.planes * plane_bytes)
    except OSError as error:
        return [Damaged(path.name, None, f"cannot be read ({error.strerror})")]
    damages = []
    for block, (recorded, digest) in enumerate(zip_longest(camera.block_digests, found)):
        if recorded != digest:
            first, last = block * camera.block_planes, min((block + 1) * camera.block_planes, camera.planes) - 1
            reason = f"planes {first} to {last} are not the recorded ones"
            damages.append(Damaged(path.name, block, reason))
    if size != camera.planes * plane_bytes:
        damages.append(Damaged(path.name, None, f"found {size} bytes, expected {camera.planes * plane_bytes}"))
    elif not damages and camera.sha256 is not None and sha256 != camera.sha256:
        damages.append(Damaged(path.name, None, "its SHA-256 is not the recorded one"))
    return damages
