"""Captures made of uploads: checked before they are queued, and imported by a worker."""

import shutil
import threading
from dataclasses import replace
from pathlib import Path

from acquisition.spikes import m1k40
from rigs.errors import RigError
from rigs.exchange.cameras import load_cameras
from rigs.rig import Rig
from rigs.toml import GRID_ID, dump_rig, load_rig
from server.engine import TASKS
from server.errors import NoRoomError, UnknownReferenceError, referred
from server.schemas.captures import ImportRequest, OfRig
from server.services.captures import RigService
from server.services.queue import Key, Queue
from server.services.space import Space
from server.services.uploads import UploadService
from server.store.store import Store
from server.store.upload_file import MOST_CAMERA_BYTES


class ImportService:
    """Imports: an entry of its own keeps the cameras' file as it was when it was asked for."""

    def __init__(self, store: Store, queue: Queue, uploads: UploadService, rigs: RigService, space: Space) -> None:
        self._store = store
        self._queue = queue
        self._uploads = uploads
        self._rigs = rigs
        self._space = space
        self._one_at_a_time = threading.Lock()

    def start(self, request: ImportRequest, key: Key = None) -> str:
        """Queue an import; return its id.

        Raises UnknownReferenceError for something that does not exist or does not fit, StateError for an upload that is
        not committed, RigError for cameras that cannot be used, NoRoomError.
        """
        (capture_id,) = self._queue.ids("capture", [request], key, "captures:import")
        with self._one_at_a_time:  # the same request may come twice at once
            if not self._queue.known(capture_id):
                self._add(capture_id, request)
        return capture_id

    def _add(self, capture_id: str, request: ImportRequest) -> None:
        names = list(request.uploads) if isinstance(request.uploads, dict) else None
        ids = list(request.uploads.values() if isinstance(request.uploads, dict) else request.uploads)
        wanted = sum(self._store.uploads.committed(upload_id).bytes for upload_id in ids)
        if len(set(ids)) < len(ids):
            raise UnknownReferenceError("found an upload twice", "one for each camera")
        folder = self._store.folder.entry(capture_id)
        try:
            cameras = self._cameras(request, folder)
        except Exception:
            self._store.folder.remove(folder)
            raise
        rig_id = request.cameras.rig if isinstance(request.cameras, OfRig) else None
        entry = self._queue.entry("capture", capture_id, request, type="import", rig=rig_id, queue=TASKS)
        asked = {name: value for name, value in entry.request.items() if name != "uploads"}
        try:
            with self._space.promised(wanted):
                self._queue.add(replace(entry, request=asked | {"dats": ids, "ids": names, "cameras": cameras.name}))
        except NoRoomError:
            self._store.folder.remove(folder)
            raise

    def _cameras(self, request: ImportRequest, folder: Path) -> Path:
        """Copy the cameras' file into the entry's folder, and read it once to see that it fits; return its path."""
        if isinstance(request.cameras, OfRig):
            path, said = folder / "cameras.toml", f"rig {request.cameras.rig}"
            self._write_rig(request.cameras.rig, path)
        else:
            upload = self._store.uploads.committed(request.cameras)
            if upload.bytes > MOST_CAMERA_BYTES:
                raise UnknownReferenceError(
                    f"found {upload.bytes} bytes of cameras",
                    f"a transforms.json or a RIG.toml of at most {MOST_CAMERA_BYTES}",
                )
            source = self._uploads.path(upload.id)
            with source.open("rb") as file:
                suffix = "json" if file.read(4096).lstrip()[:1] == b"{" else "toml"
            path, said = folder / f"cameras.{suffix}", upload.name
            shutil.copyfile(source, path)
        try:
            rig = _load(path, request)
        except RigError as error:  # its place is a file of this host, or a camera in it
            where = said + error.where.removeprefix(str(path))
            raise UnknownReferenceError(error.found, error.expected, error.do, where=where) from error
        if not isinstance(request.cameras, OfRig) and any(camera.pixels for camera in rig.cameras):
            raise UnknownReferenceError("found pixel calibrations", "none in an upload", "leave them out", where=said)
        _refuse_others(rig, request)
        return path

    def _write_rig(self, rig_id: str, path: Path) -> None:
        with referred():
            rig = self._rigs.rig(rig_id)
        calibrated = self._store.rig_files.path(rig_id)
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
    expected = f"one for each of {', '.join(rig.ids)}"
    if isinstance(request.uploads, dict):
        if set(request.uploads) != set(rig.ids):
            raise UnknownReferenceError(f"found uploads for {', '.join(request.uploads)}", expected)
    elif len(request.uploads) != len(rig.ids):
        raise UnknownReferenceError(f"found {len(request.uploads)} uploads", expected)
