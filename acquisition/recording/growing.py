"""Opens a recording that is still being written: the planes that every camera has on the disk so far."""

import dataclasses
import os
from pathlib import Path

from acquisition.errors import BadRecordingError
from acquisition.recording.journal import SUFFIX, read_journal
from acquisition.recording.manifest import UNFINISHED, CameraFile
from acquisition.recording.reader import Recording, read_any_manifest
from acquisition.recording.writer import lock_folder, partial_of
from rigs.errors import RigError


def open_growing(path: Path) -> Recording:
    """Return the recording `path`: finished, or as far as its journals prove planes of every camera.

    Nothing is read back, so a block is taken for what its journal says. Raises BadRecordingError where nothing is, or
    no camera is armed yet.
    """
    folder = partial_of(path)
    if path.exists() or not folder.is_dir():
        return Recording.open(path)
    try:
        return _open(folder, path)
    except (BadRecordingError, RigError):
        if path.exists():  # it has got its name meanwhile
            return Recording.open(path)
        raise


def is_written(path: Path) -> bool:
    """Return whether a process holds what becomes the recording `path`.

    The look itself holds it for an instant, so that a writer that begins just then is refused: look at what has long
    stood still.
    """
    try:
        os.close(lock_folder(partial_of(path)))
    except BadRecordingError:
        return True
    except OSError:  # it has its name by now, or was never there
        return False
    return False


def _open(folder: Path, path: Path) -> Recording:
    """Return what lies in `folder` of the recording that becomes `path`."""
    manifest = read_any_manifest(folder)
    if manifest.status in UNFINISHED:
        cameras = tuple(_so_far(folder, camera) for camera in manifest.cameras)
        manifest = dataclasses.replace(manifest, cameras=cameras)
    return Recording.of(folder, manifest, becomes=path)


def _so_far(folder: Path, camera: CameraFile) -> CameraFile:
    found = read_journal((folder / camera.file).with_suffix(SUFFIX), camera.block_planes)
    return dataclasses.replace(camera, planes=found.planes, block_digests=found.digests, gaps=found.gaps)
