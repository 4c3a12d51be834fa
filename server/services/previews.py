"""Pictures of recordings and their figures, each made once, and manifests."""

from __future__ import annotations

import functools
import hashlib
import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from acquisition.durable import write_durably
from acquisition.errors import BadRecordingError
from acquisition.recording.manifest import MANIFEST_FILE, CameraFile
from acquisition.recording.reader import Recording
from rigs.errors import RigError
from server.contact_sheet import camera_picture, contact_sheet, figures
from server.engine import Engine
from server.errors import NotFoundError, StateError
from server.etags import tag
from server.schemas.captures import CameraFileInfo, ManifestInfo, Verified
from server.schemas.pictures import CaptureFigures
from server.store.entries import Filter
from server.store.store import Store

_MOST_GAPS = 1000
_OPEN = 16  # recordings whose manifests stay read: one of a million planes has megabytes


@dataclass(frozen=True)
class Picture:
    """A PNG and the tag that changes when it does."""

    png: bytes
    etag: str

    @classmethod
    def of(cls, png: bytes) -> Picture:
        """Return a picture tagged by its digest."""
        return cls(png, tag(hashlib.sha256(png).hexdigest()[:32]))


class PreviewService:
    """Pictures, figures and manifests of captures that are done.

    Its methods raise NotFoundError, and StateError where a capture is not done or cannot be read.
    """

    def __init__(self, store: Store, engine: Engine) -> None:
        self._store = store
        self._engine = engine
        self._one_at_a_time = threading.Lock()
        self._opened = functools.lru_cache(_OPEN)(_opened)

    def sheet(self, capture_id: str) -> Picture:
        """Return one picture of all cameras of a capture."""
        return self._picture(capture_id, None)

    def camera(self, capture_id: str, camera_id: str) -> Picture:
        """Return a picture of one camera of a capture."""
        return self._picture(capture_id, camera_id)

    def figures(self, capture_id: str) -> CaptureFigures:
        """Return how sharp and how bright the cameras of a capture are."""
        recording = self.recording(capture_id)

        def made() -> bytes:
            return CaptureFigures(capture=capture_id, cameras=figures(recording)).model_dump_json().encode()

        return CaptureFigures.model_validate_json(self._kept(capture_id, recording.path, "figures.json", made))

    def manifest(self, capture_id: str) -> ManifestInfo:
        """Return what a capture holds and lacks."""
        manifest = self.recording(capture_id).manifest
        shown = {
            "capture": capture_id,
            "cameras": [_described(camera) for camera in manifest.cameras],
            "verified": self._verified(capture_id),
        }
        return ManifestInfo.model_validate(vars(manifest) | shown)

    def recording(self, capture_id: str) -> Recording:
        """Return the recording of a capture, opened."""
        entry = self._store.entries.get("capture", capture_id)
        path = self._store.folder.recording(entry.id)
        if not path.exists():
            raise StateError(f"found {capture_id} {self._engine.status(entry)} without a recording", "it done")
        with readable(capture_id, path):
            return self._opened(path, _stamp(path / MANIFEST_FILE))

    def _picture(self, capture_id: str, camera_id: str | None) -> Picture:
        recording = self.recording(capture_id)
        if camera_id is not None and camera_id not in recording.camera_ids:
            known = ", ".join(recording.camera_ids)
            raise NotFoundError(f"found no camera {camera_id[:60]} in {capture_id}", f"one of {known}")
        if camera_id is None:
            name, made = "preview.png", functools.partial(contact_sheet, recording)
        else:
            name, made = f"preview-{camera_id}.png", functools.partial(camera_picture, recording, camera_id)
        return Picture.of(self._kept(capture_id, recording.path, name, made))

    def _kept(self, capture_id: str, recording: Path, name: str, make: Callable[[], bytes]) -> bytes:
        """Return a file of a capture, which is made once."""
        kept = self._store.folder.entry(capture_id) / name
        with self._one_at_a_time:  # several requests for a new one make it once
            if not kept.exists():
                with readable(capture_id, recording):
                    made = make()
                write_durably(kept, made)
            return kept.read_bytes()

    def _verified(self, capture_id: str) -> Verified | None:
        jobs = self._store.entries.page(Filter("job", "verify", capture=capture_id), 1)
        if not jobs:
            return None
        (job,) = jobs
        found = Verified(job=job.id, created=job.created, status=self._engine.status(job))
        result = self._store.folder.out(job.id) / "result.json"
        if found.status != "done" or not result.exists():
            return found
        document = json.loads(result.read_text())
        return found.model_copy(update={"sound": document["sound"], "damages": document["damages"][:_MOST_GAPS]})


def _stamp(file: Path) -> tuple[int, ...]:
    """Return what changes when a file is written anew; nothing where there is none."""
    try:
        stat = file.stat()
    except OSError:
        return ()
    return stat.st_ino, stat.st_mtime_ns, stat.st_size


def _opened(path: Path, stamp: tuple[int, ...]) -> Recording:
    return Recording.open(path)


@contextmanager
def readable(capture_id: str, path: Path) -> Iterator[None]:
    """Raise StateError where the recording at `path` cannot be read, without naming places of this host."""
    try:
        yield
    except (BadRecordingError, RigError) as error:
        reason = StateError(error.found, error.expected, where=error.where.removeprefix(str(path)).lstrip("/: "))
        raise StateError(f"found the recording of {capture_id} damaged ({reason})", "it sound", "verify it") from error


def _described(camera: CameraFile) -> CameraFileInfo:
    layout = camera.layout
    return CameraFileInfo.model_validate(
        vars(camera)
        | {
            "width": layout.width,
            "height": layout.height,
            "drops": camera.drops,
            "bytes": camera.planes * layout.plane_bytes,
            "gaps": [vars(gap) for gap in camera.gaps[:_MOST_GAPS]],
            "gaps_total": len(camera.gaps),
        }
    )
