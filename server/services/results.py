"""Counts the files that a job would make, where its request tells: nobody could fetch more than are listed."""

from contextlib import suppress

from acquisition.errors import BadRecordingError
from acquisition.recording.reader import Recording
from reconstruction.errors import BadRunError
from reconstruction.export.scene import FRAMES
from reconstruction.run.folder import RunFolder
from rigs.errors import RigError
from server.errors import UnknownReferenceError
from server.schemas.job_types import ExportRequest, ImagesRequest, JobBase
from server.store.artefacts import MOST
from server.store.files import DataFolder
from server.store.tables import Entry

_OF_AN_IMAGE = 3  # intensity, valid pixels, picture
_OF_A_DATASET = 3  # cameras, points and manifest beside the pictures
_STRIDE = 20  # planes from image to image where none are named


def listable(folder: DataFolder, request: JobBase, target: Entry) -> JobBase:
    """Return the request of a job on `target`, with fewer images where it names none and too many would be made.

    Raises UnknownReferenceError where it asks for more files than are listed. Where a recording or run cannot be read
    nothing is counted: the job says what is wrong with it.
    """
    with suppress(BadRecordingError, BadRunError, RigError):
        if isinstance(request, ImagesRequest):
            recording = Recording.open(folder.recording(target.id))
            cameras, planes = len(recording.camera_ids), recording.planes
            ticks = request.ticks or _spread(planes, MOST // (cameras * _OF_AN_IMAGE))
            _expect_few(cameras, _planes(ticks or f"0:{planes}:{_STRIDE}"), _OF_AN_IMAGE, 0, "planes by `ticks`")
            return request.model_copy(update={"ticks": ticks})
        elif isinstance(request, ExportRequest) and request.format == "nerfstudio":
            run = RunFolder.open(folder.run(target.id))
            planes = min(request.frames or FRAMES, _ticks(folder, request, target, run))
            _expect_few(len(run.plan.views), planes, 1, _OF_A_DATASET, "`frames`")
    return request


def _spread(planes: int, most: int) -> str | None:
    """Return A:B:STEP that names at most so many planes; None where every 20th does."""
    stride = -(-planes // max(1, most))
    return f"0:{planes}:{stride}" if stride > _STRIDE else None


def _planes(asked: str) -> int:
    """Return how many planes A:B:STEP names."""
    first, end, step = (*map(int, asked.split(":")), 1)[:3]
    return len(range(first, end, step))


def _ticks(folder: DataFolder, request: ExportRequest, target: Entry, run: RunFolder) -> int:
    """Return how many ticks of a run the export is to cover."""
    known = run.config.part_of(Recording.open(folder.recording(target.capture or ""))).ticks
    first = known.start if request.from_tick is None else max(known.start, request.from_tick)
    last = known.stop if request.to_tick is None else min(known.stop, request.to_tick)
    return len(range(first, last))


def _expect_few(cameras: int, planes: int, each: int, beside: int, fewer: str) -> None:
    files = cameras * planes * each + beside
    if files > MOST:
        found = f"found {files} files, of {cameras} cameras at {planes} planes"
        do = f"ask for at most {(MOST - beside) // (cameras * each)} {fewer}"
        raise UnknownReferenceError(found, f"at most {MOST}, which can be listed", do)
