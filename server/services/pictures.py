"""Pictures of a reconstruction: what its training has learnt so far, and what its cameras took.

The former the training draws itself, the latter are made of spikes when they are asked for.
"""

import functools
import io
import json
import threading
from dataclasses import dataclass

from PIL import Image

from acquisition.recording.reader import Recording
from reconstruction.report.seen import SEEN_BY, seen
from server.engine import Engine
from server.errors import NotFoundError, StateError, UnknownReferenceError
from server.schemas.jobs import CameraPictures
from server.services.artefacts import ArtefactService
from server.services.previews import Picture, PreviewService, readable
from server.store.store import Store

_KEPT = 256  # pictures in memory, some 50 kB each


@dataclass(frozen=True)
class Pictured:
    """The recording `name`, whose pictures stand beside renders of its scene; `white` (spikes a tick) is shown so."""

    name: str
    white: float
    recording: Recording

    def described(self) -> CameraPictures:
        """Say which pictures there are, and how they are made."""
        return CameraPictures(
            method=SEEN_BY,
            capture=self.name,
            cameras=list(self.recording.camera_ids),
            planes=self.recording.planes,
            tick_rate_hz=self.recording.tick_rate_hz,
            white=self.white,
        )

    def picture(self, camera_id: str, plane: int) -> Picture:
        """Return what a camera saw at a plane.

        Raises NotFoundError for no such camera, UnknownReferenceError for a plane that there is not, and StateError
        where the recording cannot be read.
        """
        if camera_id not in self.recording.camera_ids:
            known = ", ".join(self.recording.camera_ids)
            raise NotFoundError(f"found no camera {camera_id[:60]} in {self.name}", f"one of {known}")
        if plane >= self.recording.planes:
            raise UnknownReferenceError(f"found the plane {plane}", f"one of 0 to {self.recording.planes - 1}")
        buffer = io.BytesIO()
        with readable(self.name, self.recording.path):
            shown = Image.fromarray(seen(self.recording.stream(camera_id), plane, self.white))
        shown.save(buffer, "PNG", compress_level=3)
        return Picture.of(buffer.getvalue())


class PictureService:
    """Pictures from the places of a reconstruction's cameras, as bright as its renders.

    A held-out camera's are made only of a job that is done, so after its scoring, and nothing reads them but people.
    """

    def __init__(self, store: Store, engine: Engine, artefacts: ArtefactService, previews: PreviewService) -> None:
        self._store = store
        self._engine = engine
        self._artefacts = artefacts
        self._previews = previews
        self._one_at_a_time = threading.Lock()
        self._drawn = functools.lru_cache(_KEPT)(Pictured.picture)

    def of(self, job_id: str) -> CameraPictures:
        """Say which pictures there are; raises as `picture`."""
        return self._source(job_id).described()

    def picture(self, job_id: str, camera_id: str, plane: int) -> Picture:
        """Return what a camera saw at a plane.

        Raises NotFoundError for no such job, scene, capture or camera, StateError where the job is not done or the
        recording cannot be read, and UnknownReferenceError for a plane that there is not.
        """
        source = self._source(job_id)
        with self._one_at_a_time:
            return self._drawn(source, camera_id, plane)

    def preview(self, job_id: str) -> Picture:
        """Return the newest picture that a training has drawn of its scene; raises NotFoundError where it has none."""
        entry = self._store.entries.get("job", job_id)
        try:
            return Picture.of((self._store.folder.run(entry.id) / "preview.png").read_bytes())
        except FileNotFoundError as error:
            raise NotFoundError(f"found no preview of {job_id}", "a reconstruction whose training has begun") from error

    def _source(self, job_id: str) -> Pictured:
        """Return the recording that a finished job's scene was made of."""
        path, _ = self._artefacts.find(job_id, "viewer.json")
        entry = self._store.entries.get("job", job_id)
        status = self._engine.status(entry)
        if status != "done" or entry.capture is None:
            raise StateError(f"found {job_id} {status}", "it done", "its held-out camera is not scored yet")
        white = float(json.loads(path.read_text())["white"])
        return Pictured(entry.capture, white, self._previews.recording(entry.capture))
