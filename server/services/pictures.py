"""Pictures of a reconstruction: what its training has learnt so far, and what its cameras took.

The former the training draws itself, the latter are made of spikes when they are asked for.
"""

import functools
import io
import json
import threading

from PIL import Image

from acquisition.recording.reader import Recording
from reconstruction.images.catalogue import method
from reconstruction.report.display import grey
from server.engine import Engine
from server.errors import NotFoundError, StateError, UnknownReferenceError
from server.schemas.jobs import CameraPictures
from server.services.artefacts import ArtefactService
from server.services.previews import Picture, PreviewService, readable
from server.store.store import Store

METHOD = "adaptive"  # the best by tests/benchmarks/images.json of those that need no learned network
_KEPT = 256  # pictures in memory, some 50 kB each


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
        self._drawn = functools.lru_cache(_KEPT)(_drawn)

    def of(self, job_id: str) -> CameraPictures:
        """Say which pictures there are; raises as `picture`."""
        capture_id, white, found = self._source(job_id)
        return CameraPictures(
            method=METHOD,
            capture=capture_id,
            cameras=list(found.camera_ids),
            planes=found.planes,
            tick_rate_hz=found.tick_rate_hz,
            white=white,
        )

    def picture(self, job_id: str, camera_id: str, plane: int) -> Picture:
        """Return what a camera saw at a plane.

        Raises NotFoundError for no such job, scene, capture or camera, StateError where the job is not done or the
        recording cannot be read, and UnknownReferenceError for a plane that there is not.
        """
        capture_id, white, recording = self._source(job_id)
        if camera_id not in recording.camera_ids:
            known = ", ".join(recording.camera_ids)
            raise NotFoundError(f"found no camera {camera_id[:60]} in {capture_id}", f"one of {known}")
        if plane >= recording.planes:
            raise UnknownReferenceError(f"found the plane {plane}", f"one of 0 to {recording.planes - 1}")
        with self._one_at_a_time, readable(capture_id, recording.path):
            return self._drawn(recording, camera_id, plane, white)

    def preview(self, job_id: str) -> Picture:
        """Return the newest picture that a training has drawn of its scene; raises NotFoundError where it has none."""
        entry = self._store.entries.get("job", job_id)
        try:
            return Picture.of((self._store.folder.run(entry.id) / "preview.png").read_bytes())
        except FileNotFoundError as error:
            raise NotFoundError(f"found no preview of {job_id}", "a reconstruction whose training has begun") from error

    def _source(self, job_id: str) -> tuple[str, float, Recording]:
        """Return the capture that a finished job's scene was made of, the scene's white, and the recording."""
        path, _ = self._artefacts.find(job_id, "viewer.json")
        entry = self._store.entries.get("job", job_id)
        status = self._engine.status(entry)
        if status != "done" or entry.capture is None:
            raise StateError(f"found {job_id} {status}", "it done", "its held-out camera is not scored yet")
        return entry.capture, float(json.loads(path.read_text())["white"]), self._previews.recording(entry.capture)


def _drawn(recording: Recording, camera_id: str, plane: int, white: float) -> Picture:
    estimate = method(METHOD)(recording.stream(camera_id), plane)
    buffer = io.BytesIO()
    Image.fromarray(grey(estimate.intensity, white)).save(buffer, "PNG", compress_level=3)
    return Picture.of(buffer.getvalue())
