"""What recordings look like and what they hold: pictures made once, and the manifest."""

from __future__ import annotations

import hashlib
import json
import threading
from dataclasses import dataclass
from pathlib import Path

from acquisition.durable import write_durably
from acquisition.errors import BadRecordingError
from acquisition.recording.manifest import CameraFile
from acquisition.recording.reader import Recording
from rigs.errors import RigError
from server.contact_sheet import camera_picture, contact_sheet
from server.engine import Engine
from server.errors import NotFoundError, StateError
from server.schemas.captures import CameraFileInfo, GapInfo, ManifestInfo, Verified
from server.store.entries import Filter
from server.store.store import Store

_MOST_GAPS = 1000


@dataclass(frozen=True)
class Picture:
    """A PNG and the tag that changes when it does."""

    png: bytes
    etag: str

    @classmethod
    def of(cls, png: bytes) -> Picture:
        """A picture tagged by its digest."""
        return cls(png, f'"{hashlib.sha256(png).hexdigest()[:32]}"')


class PreviewService:
    """Pictures and manifests of captures that are done."""

    def __init__(self, store: Store, engine: Engine) -> None:
        self._store = store
        self._engine = engine
        self._one_at_a_time = threading.Lock()

    def sheet(self, capture_id: str) -> Picture:
        """All cameras of a capture; raises NotFoundError, StateError where it is not done or cannot be read."""
        return self._picture(capture_id, None)

    def camera(self, capture_id: str, camera_id: str) -> Picture:
        """One camera of a capture; raises NotFoundError, StateError where it is not done or cannot be read."""
        return self._picture(capture_id, camera_id)

    def manifest(self, capture_id: str) -> ManifestInfo:
        """What a capture holds and lacks; raises NotFoundError, StateError where it is not done or cannot be read."""
        manifest = self._recording(capture_id).manifest
        return ManifestInfo(
            capture=capture_id,
            tick_rate_hz=manifest.tick_rate_hz,
            trigger=manifest.trigger,
            writer=manifest.writer,
            status=manifest.status,
            reason=manifest.reason,
            direct_io=manifest.direct_io,
            trigger_plane=manifest.trigger_plane,
            cameras=[_described(camera) for camera in manifest.cameras],
            verified=self._verified(capture_id),
        )

    def _picture(self, capture_id: str, camera_id: str | None) -> Picture:
        recording = self._recording(capture_id)
        if camera_id is not None and camera_id not in recording.camera_ids:
            known = ", ".join(recording.camera_ids)
            raise NotFoundError(f"found no camera {camera_id[:60]} in {capture_id}", f"one of {known}")
        name = "preview.png" if camera_id is None else f"preview-{camera_id}.png"
        kept = self._store.folder.entry(capture_id) / name
        with self._one_at_a_time:  # several requests for a new one make it once
            if not kept.exists():
                write_durably(kept, _made(recording, camera_id))
            return Picture.of(kept.read_bytes())

    def _recording(self, capture_id: str) -> Recording:
        entry = self._store.entries.get("capture", capture_id)
        path = self._store.folder.recording(entry.id)
        if not path.exists():
            status = self._engine.statuses([entry])[entry.id]
            raise StateError(f"found {capture_id} {status} without a recording", "it done")
        try:
            return Recording.open(path)
        except (BadRecordingError, RigError) as error:
            raise _damaged(capture_id, path, error) from error

    def _verified(self, capture_id: str) -> Verified | None:
        jobs = self._store.entries.page(Filter("job", "verify", capture=capture_id), 1)
        if not jobs:
            return None
        (job,) = jobs
        found = Verified(job=job.id, created=job.created, status=self._engine.statuses(jobs)[job.id])
        result = self._store.folder.out(job.id) / "result.json"
        if found.status != "done" or not result.exists():
            return found
        document = json.loads(result.read_text())
        return found.model_copy(update={"sound": document["sound"], "damages": document["damages"][:_MOST_GAPS]})


def _made(recording: Recording, camera_id: str | None) -> bytes:
    try:
        return contact_sheet(recording) if camera_id is None else camera_picture(recording, camera_id)
    except BadRecordingError as error:
        raise _damaged(recording.path.name, recording.path, error) from error


def _damaged(capture_id: str, path: Path, error: Exception) -> StateError:
    reason = str(error).replace(f"{path}/", "").replace(f"{path}: ", "")
    return StateError(f"found the recording of {capture_id} damaged ({reason})", "it sound", "verify it")


def _described(camera: CameraFile) -> CameraFileInfo:
    gaps = [GapInfo(**vars(gap)) for gap in camera.gaps[:_MOST_GAPS]]
    return CameraFileInfo(
        id=camera.id,
        width=camera.layout.width,
        height=camera.layout.height,
        planes=camera.planes,
        first_tick=camera.first_tick,
        bytes=camera.planes * camera.layout.plane_bytes,
        sha256=camera.sha256,
        drops=camera.drops,
        gaps=gaps,
        gaps_total=len(camera.gaps),
        skew_s=camera.skew_s,
        skew_sd_s=camera.skew_sd_s,
        partial_bytes=camera.partial_bytes,
        device=camera.device,
    )
