"""The calibrations of a rig as files: the rig file that captures use, the pixel maps, and the pictures.

DATA/rigs/RIG/calibration.toml         the current calibration; absent where the rig is used as it was drawn
DATA/rigs/RIG/drawn.toml               the rig as it was drawn
DATA/rigs/RIG/camRC-pixels-SHA.npz     pixel maps, named by what is in them, so that none is ever overwritten
DATA/rigs/RIG/pictures/JID.png         the residuals of the calibration that a job found
"""

import dataclasses
import hashlib
import os
from pathlib import Path

from acquisition.durable import write_durably
from rigs.rig import Rig
from server.errors import RigMismatchError
from server.store.calibrations import Calibrations
from server.store.files import DataFolder, locked
from server.store.known_rigs import KnownRigs


class RigFiles:
    """The files of one service's rigs."""

    def __init__(self, folder: DataFolder, calibrations: Calibrations, known_rigs: KnownRigs) -> None:
        self._folder = folder
        self._calibrations = calibrations
        self._known_rigs = known_rigs

    def path(self, rig_id: str) -> Path:
        """Return where the current calibration lies, if there is one."""
        return self._folder.rig(rig_id) / "calibration.toml"

    def refresh(self, rig_id: str) -> Path:
        """Bring the file up to date with the database and return its path; raises DiskError.

        The last writer has read last, so a crash or a race leaves nothing stale that the next call does not mend.
        """
        path = self.path(rig_id)
        with locked(path.with_name(".calibration.lock"), os.O_RDWR | os.O_CREAT, wait=True):
            _, stored = self._calibrations.current(rig_id)
            if stored is None:
                path.unlink(missing_ok=True)
            elif not path.exists() or path.read_text() != stored.document:
                write_durably(path, stored.document)
        return path

    def drawn(self, rig_id: str) -> Path:
        """Return the rig file as it was drawn, brought up to date; raises NotFoundError, DiskError."""
        document = self._known_rigs.get(rig_id).document
        path = self._folder.rig(rig_id) / "drawn.toml"
        if not path.exists() or path.read_text() != document:
            write_durably(path, document)
        return path

    def adopt_pixels(self, rig_id: str, rig: Rig) -> Rig:
        """Copy the pixel maps of `rig` among the rig's files; return `rig` with the copies. Raises DiskError."""
        cameras = []
        for camera in rig.cameras:
            if camera.pixels is not None:
                data = camera.pixels.read_bytes()
                name = f"{camera.id}-pixels-{hashlib.sha256(data).hexdigest()[:16]}.npz"
                kept = self._folder.rig(rig_id) / name
                if not kept.exists():
                    write_durably(kept, data)
                camera = dataclasses.replace(camera, pixels=kept)
            cameras.append(camera)
        return dataclasses.replace(rig, cameras=tuple(cameras))

    def picture(self, rig_id: str, job_id: str) -> Path:
        """Return where the picture of the calibration that a job found lies, if it made one."""
        folder = self._folder.rig(rig_id) / "pictures"
        folder.mkdir(exist_ok=True)
        return folder / f"{job_id}.png"


def fitted(found: Rig, rig: Rig) -> Rig:
    """Return the measurements of `found` with the order, name, rate and serials of `rig`.

    Raises RigMismatchError where `found` is of other cameras: ids, sizes, serials where both have them, or tick rate.
    """
    sizes = [{c.id: f"{c.width}x{c.height}" for c in one.cameras} for one in (found, rig)]
    for camera_id in [*rig.ids, *found.ids]:
        has, wants = (size.get(camera_id, "none") for size in sizes)
        if has != wants:
            raise RigMismatchError(f"found a camera of {has} pixels", f"{wants} as in rig {rig.name}", where=camera_id)
    for camera in rig.cameras:
        serial = found.camera(camera.id).serial
        if serial and camera.serial and serial != camera.serial:
            raise RigMismatchError(
                f"found the serial {serial[:40]!r}", f"{camera.serial!r} as in rig {rig.name}", where=camera.id
            )
    if found.tick_rate_hz != rig.tick_rate_hz:
        raise RigMismatchError(f"found {found.tick_rate_hz:g} Hz", f"{rig.tick_rate_hz:g} as in rig {rig.name}")
    cameras = (dataclasses.replace(found.camera(c.id), serial=c.serial) for c in rig.cameras)
    return dataclasses.replace(found, name=rig.name, cameras=tuple(cameras))


def with_pixels_of(rig: Rig, other: Rig) -> Rig:
    """Return `rig` with the pixel maps of those cameras of `other` that have one."""
    cameras = (dataclasses.replace(c, pixels=other.camera(c.id).pixels or c.pixels) for c in rig.cameras)
    return dataclasses.replace(rig, cameras=tuple(cameras))


def without_pixels(rig: Rig) -> Rig:
    """Return `rig` without its pixel maps."""
    return dataclasses.replace(rig, cameras=tuple(dataclasses.replace(c, pixels=None) for c in rig.cameras))
