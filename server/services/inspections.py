"""Looks into uploads before they are imported: the layouts they may have, and a picture."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
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
_MOST_PIXELS = 4_000_000  # of a picture


class InspectionService:
    """The contents of uploads, from the bytes that have come so far. Its methods raise NotFoundError."""

    def __init__(self, uploads: UploadService, rigs: RigService) -> None:
        self._uploads = uploads
        self._rigs = rigs
        self._one_at_a_time = threading.Lock()  # a picture of many pixels takes some hundred megabytes

    def inspection(self, upload_id: str, size: Size | None) -> Inspection:
        """Return the layouts that an upload may have, of `size` (width, height) or of the sizes that are known."""
        upload = self._uploads.get(upload_id)
        sizes = [size] if size else self._sizes()
        with _bytes_of(self._uploads.path(upload_id)) as data:
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
        if asked.format == "m1k40":
            layout = m1k40.LAYOUT
        elif asked.width is None or asked.height is None:
            raise UnknownReferenceError(f"found no width and height for {asked.format}", "both")
        else:
            trailing = TRAILING_COLUMNS[asked.format]
            layout = PlaneLayout(asked.width, asked.height, asked.bit_order, asked.row_order, trailing)
        with self._one_at_a_time, _bytes_of(self._uploads.path(upload_id)) as data:
            if layout.width * layout.height > _MOST_PIXELS and layout.plane_bytes <= len(data):
                found = f"found a picture of {layout.width}x{layout.height}"
                raise UnknownReferenceError(found, f"at most {_MOST_PIXELS} pixels")
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


class _Received:
    """The bytes of an open file that have come, read where they are asked for: a mapped file may be cut off meanwhile.

    Raises StateError where it was.
    """

    def __init__(self, handle: int) -> None:
        self._handle = handle
        self._size = os.fstat(handle).st_size

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> Bytes:
        first, last, _ = part.indices(self._size)
        data = os.pread(self._handle, max(0, last - first), first)
        if len(data) < last - first:
            raise StateError("found the upload cut off while it was looked at", "it as it was", "look again")
        return np.frombuffer(data, dtype=np.uint8)


@contextmanager
def _bytes_of(path: Path) -> Iterator[_Received]:
    """Open the bytes that have come."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except FileNotFoundError as error:  # it is being deleted
        raise StateError("found the upload deleted", "it there") from error
    try:
        yield _Received(handle)
    finally:
        os.close(handle)


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
