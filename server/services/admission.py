"""Admits jobs that can be done: the capture or job they work on is there, ready, and has the cameras they name."""

from acquisition.errors import BadRecordingError
from acquisition.recording.reader import Recording
from reconstruction.rendering.limits import frames_to_render
from rigs.toml import load_rig
from server.engine import Engine
from server.errors import RigMismatchError, StateError, UnknownReferenceError, referred
from server.schemas.job_types import (
    CalibrateRequest,
    CheckRigRequest,
    ExportRequest,
    JobBase,
    OfCapture,
    OfJob,
    ReconstructRequest,
    RenderRequest,
)
from server.schemas.progress import ACTIVE
from server.services.captures import RigService
from server.store.rig_files import fitted
from server.store.store import Store
from server.store.tables import Entry
from server.store.upload_file import MOST_CAMERA_BYTES


class Admission:
    """Checks the requests for jobs of a service."""

    def __init__(self, store: Store, engine: Engine, rigs: RigService) -> None:
        self._store = store
        self._engine = engine
        self._rigs = rigs

    def target(self, request: JobBase, *, waits: bool) -> Entry:
        """Return the capture or job that a job works on; it is done, unless the job waits for it.

        Raises UnknownReferenceError also for ticks it lacks, StateError, RigError for a camera it lacks,
        RigMismatchError.
        """
        with referred():
            if isinstance(request, OfJob):
                target = self._store.entries.get("job", request.job)
                if target.type != "reconstruct":
                    raise UnknownReferenceError(f"found the job {target.id} of type {target.type}", "reconstruct")
            else:
                assert isinstance(request, OfCapture)
                target = self._store.entries.get("capture", request.capture)
        if isinstance(request, ReconstructRequest) and request.follow and self._engine.status(target) in ACTIVE:
            self._check_followed(request, target)
        elif not waits:
            self._expect_done(target)
            self._check_cameras(request, target)
            if isinstance(request, ReconstructRequest):
                self._check_ticks(request, target)
            if isinstance(request, (CalibrateRequest, CheckRigRequest)):
                self._check_rig(request, target)
        if isinstance(request, RenderRequest):
            upload = self._store.uploads.committed(request.cameras)
            if upload.bytes > MOST_CAMERA_BYTES:
                expected = f"a transforms.json of at most {MOST_CAMERA_BYTES}"
                raise UnknownReferenceError(f"found {upload.bytes} bytes of cameras", expected)
            frames_to_render(self._store.folder.upload(upload.id) / "data")
        return target

    def _expect_done(self, target: Entry) -> None:
        status = self._engine.status(target)
        if status != "done":
            raise StateError(f"found {target.kind} {target.id} {status}", "it done", "wait for it")

    def _check_rig(self, request: CalibrateRequest | CheckRigRequest, target: Entry) -> None:
        """Check that a rig is calibrated and checked with captures of its own cameras."""
        captures = [target]
        with referred():
            rig = None if request.rig is None else self._rigs.rig(request.rig)
            if isinstance(request, CalibrateRequest) and request.dark is not None:
                captures.append(self._store.entries.get("capture", request.dark))
        for capture in captures:
            self._expect_done(capture)
            if rig is None:
                continue
            if capture.rig not in (None, request.rig):
                raise RigMismatchError(f"found {capture.id} of rig {capture.rig}", f"one of {request.rig}")
            fitted(load_rig(self._store.folder.recording(capture.id) / "rig.toml"), rig)

    def _check_ticks(self, request: ReconstructRequest, target: Entry) -> None:
        """Check that a capture has the ticks that are asked for."""
        if request.from_tick is request.to_tick is None:
            return
        try:
            used = _named(request) if request.views else ()
            Recording.open(self._store.folder.recording(target.id)).part(request.from_tick, request.to_tick, used)
        except BadRecordingError as error:
            do = "change `from_tick` or `to_tick`"
            raise UnknownReferenceError(error.found, error.expected, do) from error

    def _check_followed(self, request: ReconstructRequest, target: Entry) -> None:
        """Check a reconstruction of a capture that is still recorded: of all of it, with cameras that its rig has."""
        if target.rig is None:
            raise StateError(f"found capture {target.id} being imported", "it done", "wait for it")
        rig = self._rigs.rig(target.rig)
        for camera in _named(request):
            rig.camera(camera)

    def _check_cameras(self, request: JobBase, target: Entry) -> None:
        wanted = _named(request)
        capture = target.id if target.kind == "capture" else target.capture
        if wanted and capture is not None:
            rig = load_rig(self._store.folder.recording(capture) / "rig.toml")
            for camera in wanted:
                rig.camera(camera)


def _named(request: JobBase) -> list[str]:
    """Return the cameras that a request names."""
    named: list[str | None] = []
    if isinstance(request, ReconstructRequest):
        named = [request.holdout, *(request.views or [])]
    elif isinstance(request, ExportRequest):
        named = [request.camera]
    return [camera for camera in named if camera is not None]
