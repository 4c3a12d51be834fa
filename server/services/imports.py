"""Captures made of uploads: checked before they are queued, and imported by a worker."""

from __future__ import annotations

import shutil
from pathlib import Path

from acquisition.spikes import m1k40
from rigs.errors import RigError
from rigs.exchange.cameras import load_cameras
from rigs.rig import Rig
from rigs.toml import GRID_ID, dump_rig, load_rig
from server.engine import TASKS
from server.errors import NotFoundError, UnknownReferenceError
from server.schemas.captures import ImportRequest, OfRig
from server.services.captures import RigService
from server.services.queue import Key, Queue
from server.services.uploads import UploadService
from server.store.entries import Entry
from server.store.store import Store

_MOST_CAMERA_BYTES = 16 << 20


class ImportService:
    """Imports: an entry of its own keeps the cameras' file as it was when it was asked for."""

    def __init__(self, store: Store, queue: Queue, uploads: UploadService, rigs: RigService) -> None:
        self._store = store
        self._queue = queue
        self._uploads = uploads
        self._rigs = rigs

    def start(self, request: ImportRequest, key: Key = None) -> str:
        """Queue an import; its id.

        Raises UnknownReferenceError for what does not exist or does not fit, StateError for an upload that is not
        committed, RigError for cameras that cannot be used.
        """
        (capture_id,) = self._queue.ids("capture", [request], key, "captures:import")
        if self._queue.known(capture_id):
            return capture_id
        named = isinstance(request.uploads, dict)
        ids = list(request.uploads.values() if isinstance(request.uploads, dict) else request.uploads)
        for upload_id in ids:
            self._store.uploads.committed(upload_id)
        if len(set(ids)) < len(ids):
            raise UnknownReferenceError("found an upload twice", "one for each camera")
        folder = self._store.folder.entry(capture_id)
        try:
            cameras = self._cameras(request, folder)
        except Exception:
            self._store.folder.remove(folder)
            raise
        options = request.model_dump(exclude={"name", "uploads", "cameras"})
        dats = {"dats": ids, "ids": list(request.uploads) if named else None, "cameras": cameras.name}
        entry = Entry(
            id=capture_id,
            kind="capture",
            type="import",
            created=self._store.entries.created(),
            request=options | dats,
            rig=request.cameras.rig if isinstance(request.cameras, OfRig) else None,
            name=request.name,
            queue=TASKS,
        )
        self._queue.add(entry)
        return capture_id

    def _cameras(self, request: ImportRequest, folder: Path) -> Path:
        """The cameras' file, copied into the entry's folder and read once to see that it fits."""
        if isinstance(request.cameras, OfRig):
            path, said = folder / "cameras.toml", f"rig {request.cameras.rig}"
            self._write_rig(request.cameras.rig, path)
        else:
            upload = self._store.uploads.committed(request.cameras)
            if upload.bytes > _MOST_CAMERA_BYTES:
                raise UnknownReferenceError(
                    f"found {upload.bytes} bytes of cameras",
                    f"a transforms.json or a RIG.toml of at most {_MOST_CAMERA_BYTES}",
                )
            source = self._uploads.path(upload.id)
            with source.open("rb") as file:
                suffix = "json" if file.read(4096).lstrip()[:1] == b"{" else "toml"
            path, said = folder / f"cameras.{suffix}", upload.name
            shutil.copyfile(source, path)
        try:
            rig = _load(path, request)
        except RigError as error:
            raise UnknownReferenceError(str(error).replace(str(path), said)) from error
        if not isinstance(request.cameras, OfRig) and any(camera.pixels for camera in rig.cameras):
            raise UnknownReferenceError("found pixel calibrations", "none in an upload", "leave them out", where=said)
        _refuse_others(rig, request)
        return path

    def _write_rig(self, rig_id: str, path: Path) -> None:
        try:
            rig = self._rigs.rig(rig_id)
        except NotFoundError as error:
            raise UnknownReferenceError(str(error)) from error
        calibrated = self._store.folder.rig(rig_id) / "calibration.toml"
        rig = load_rig(calibrated) if calibrated.exists() else rig
        for pixels in {camera.pixels for camera in rig.cameras if camera.pixels}:
            shutil.copyfile(pixels, path.with_name(pixels.name))
        path.write_text(dump_rig(rig))


def _load(path: Path, request: ImportRequest) -> Rig:
    names = list(request.uploads) if isinstance(request.uploads, dict) else []
    grid = all(GRID_ID.fullmatch(name) for name in names)
    fixed = (m1k40.SIDE, m1k40.SIDE) if request.format == "m1k40" else None
    return load_cameras(path, request.tick_rate_hz, size=request.size or fixed, ids=None if grid else names)


def _refuse_others(rig: Rig, request: ImportRequest) -> None:
    expected = f"expected one for each of {', '.join(rig.ids)}"
    if isinstance(request.uploads, dict):
        if set(request.uploads) != set(rig.ids):
            raise UnknownReferenceError(f"found uploads for {', '.join(request.uploads)}, {expected}")
    elif len(request.uploads) != len(rig.ids):
        raise UnknownReferenceError(f"found {len(request.uploads)} uploads, {expected}")
