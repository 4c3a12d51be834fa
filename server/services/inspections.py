"""Looks into uploads before they are imported: the layouts they may have, and a picture."""

from pathlib import Path

import numpy as np

from acquisition.errors import BadRecordingError
from acquisition.recording.importing import TRAILING_COLUMNS
from acquisition.recording.inspection import LIKELY, SIZES, Candidate, Size, inspect, middle_planes
from acquisition.spikes import m1k40
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import Bytes, counts
from server.contact_sheet import mean_picture
from server.errors import StateError, UnknownReferenceError
from server.schemas.uploads import Inspection, LayoutAsked, LayoutFound
from server.services.captures import RigService
from server.services.previews import Picture
from server.services.uploads import UploadService

_MOST_CANDIDATES = 8


class InspectionService:
    """The contents of uploads, from the bytes that have come so far. Its methods raise NotFoundError."""

    def __init__(self, uploads: UploadService, rigs: RigService) -> None:
        self._uploads = uploads
        self._rigs = rigs

    def inspection(self, upload_id: str, size: Size | None) -> Inspection:
        """Return the layouts that an upload may have, of `size` (width, height) or of the sizes that are known."""
        upload = self._uploads.get(upload_id)
        data = _bytes_of(self._uploads.path(upload_id))
        sizes = [size] if size else self._sizes()
        found = inspect(data, upload.bytes, sizes)[:_MOST_CANDIDATES]
        return Inspection(
            upload=upload.id,
            bytes=upload.bytes,
            received=len(data),
            candidates=[_shown(one) for one in found],
            doubt=_doubt(found, upload.bytes, sizes),
        )

    def picture(self, upload_id: str, asked: LayoutAsked) -> Picture:
        """Return the mean of some planes in a layout that the client chose.

        Raises UnknownReferenceError for one that cannot be, StateError before a whole plane has come.
        """
        self._uploads.get(upload_id)
        data = _bytes_of(self._uploads.path(upload_id))
        if asked.format == "m1k40":
            layout = m1k40.LAYOUT
        elif asked.width is None or asked.height is None:
            raise UnknownReferenceError(f"found no width and height for {asked.format}", "both")
        else:
            trailing = TRAILING_COLUMNS[asked.format]
            layout = PlaneLayout(asked.width, asked.height, asked.bit_order, asked.row_order, trailing)
        try:
            packed = middle_planes(data, asked.format, layout)
        except BadRecordingError as error:
            raise UnknownReferenceError(error.found, error.expected, error.do) from error
        if not len(packed):
            raise StateError(f"found {len(data)} bytes of {upload_id}", f"a plane, {layout.plane_bytes} bytes")
        return Picture.of(mean_picture(counts(packed, layout).astype(np.float32) / np.float32(len(packed))))

    def _sizes(self) -> list[Size]:
        """Return the sizes of this service's cameras and of those that recordings were published of."""
        mine = [(camera.width, camera.height) for rig in self._rigs.rigs.values() for camera in rig.cameras]
        return list(dict.fromkeys([*mine, *SIZES]))


def _bytes_of(path: Path) -> Bytes:
    """Map the bytes [n] that have come."""
    try:
        return np.memmap(path, dtype=np.uint8, mode="r") if path.stat().st_size else np.empty(0, dtype=np.uint8)
    except FileNotFoundError as error:  # it is being deleted
        raise StateError("found the upload deleted", "it there") from error


def _shown(one: Candidate) -> LayoutFound:
    size = {"width": one.layout.width, "height": one.layout.height, "bit_order": one.layout.bit_order}
    return LayoutFound.model_validate(vars(one) | size)


def _doubt(found: list[Candidate], total: int, sizes: list[Size]) -> str | None:
    """Return a line for a file that fits nothing well."""
    tried = ", ".join(f"{width}x{height}" for width, height in sizes)
    if not found:
        return f"found {total} bytes, less than a plane of {tried}; give the size of its camera"
    if found[0].plausibility < LIKELY:
        return (
            f"found neighbouring pixels unlike in {total} bytes read as {tried}; give the size, or look at the picture"
        )
    if found[0].left_bytes:
        one = found[0]
        return (
            f"found {one.left_bytes} bytes behind {one.planes} whole planes of {one.layout.width}x{one.layout.height}"
        )
    return None
