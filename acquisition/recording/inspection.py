"""Finds the layouts that the bytes of a `.dat` may have, before it is imported."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Protocol

from acquisition.errors import BadRecordingError
from acquisition.recording.importing import TRAILING_COLUMNS, SourceFormat
from acquisition.spikes import m1k40
from acquisition.spikes.layout import BitOrder, PlaneLayout
from acquisition.spikes.packing import Bytes
from acquisition.spikes.plausibility import MOST_PLANES, plausibility

Size = tuple[int, int]
SIZES: tuple[Size, ...] = ((400, 250), (250, 250), (1000, 1000))  # of sensors that recordings were published of
LIKELY = 0.3  # least plausibility of a layout that fits; wrong ones of the recordings at hand stay below
_M1K40_PLANE_BYTES = m1k40.SEGMENTS * m1k40.SEGMENT_BYTES
_M1K40_SEARCHED_BYTES = 16 * _M1K40_PLANE_BYTES
_BIT_ORDERS: tuple[BitOrder, ...] = ("lsb", "msb")


@dataclass(frozen=True)
class Candidate:
    """A layout that a file may have: it would be `planes` planes, and `left_bytes` more.

    `plausibility` is 1 where neighbouring pixels are alike in every respect, and about 0 for noise.
    """

    format: SourceFormat
    layout: PlaneLayout
    planes: int
    left_bytes: int
    plausibility: float


class Stored(Protocol):
    """Bytes [n] in memory or in a file; a slice of them is an array."""

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice, /) -> Bytes: ...


def inspect(data: Stored, total: int, sizes: Iterable[Size]) -> list[Candidate]:
    """Return the layouts that a file of `total` bytes may have, the likeliest first.

    `data` [n] are the bytes that are there, its first ones; `sizes` (width, height) those to try. A layout whose planes
    are longer than `data` is left out.
    """
    found: list[tuple[Candidate, float]] = []
    for source_format, layout in _layouts(data, sizes):
        whole, left = divmod(total, _stored_bytes(source_format, layout))
        alike, contrast = plausibility(middle_planes(data, source_format, layout), layout)
        found.append((Candidate(source_format, layout, whole, left, alike), contrast))
    most = max((contrast for _, contrast in found), default=0.0) or 1.0
    rated = [replace(one, plausibility=one.plausibility * contrast / most) for one, contrast in found]
    return sorted(rated, key=lambda one: (one.plausibility, -one.left_bytes), reverse=True)


def middle_planes(data: Stored, source_format: SourceFormat, layout: PlaneLayout) -> Bytes:
    """Return some packed planes [T, B] from the middle of the bytes [n] that are there; none where they hold none.

    Raises BadRecordingError where M1K40 is asked for and the bytes are not.
    """
    if source_format == "m1k40":
        stream = m1k40.locate(data[:_M1K40_SEARCHED_BYTES])
        return stream.window(0, min(len(stream), MOST_PLANES))
    planes = len(data) // layout.plane_bytes
    first = max(0, planes // 2 - MOST_PLANES // 2)
    last = min(planes, first + MOST_PLANES)
    return data[first * layout.plane_bytes : last * layout.plane_bytes].reshape(last - first, layout.plane_bytes)


def _layouts(data: Stored, sizes: Iterable[Size]) -> Iterable[tuple[SourceFormat, PlaneLayout]]:
    if _is_m1k40(data):
        yield "m1k40", m1k40.LAYOUT
    plain: tuple[SourceFormat, ...] = ("vidar", "vidar416")
    for source_format in plain:
        for width, height in sizes:
            for order in _BIT_ORDERS:
                layout = PlaneLayout(width, height, order, "bottom", TRAILING_COLUMNS[source_format])
                if layout.plane_bytes <= len(data):
                    yield source_format, layout


def _is_m1k40(data: Stored) -> bool:
    try:
        m1k40.locate(data[:_M1K40_SEARCHED_BYTES])
    except BadRecordingError:
        return False
    return True


def _stored_bytes(source_format: SourceFormat, layout: PlaneLayout) -> int:
    return _M1K40_PLANE_BYTES if source_format == "m1k40" else layout.plane_bytes
