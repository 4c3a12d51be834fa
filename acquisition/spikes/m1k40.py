"""Decodes raw streams of the 1000x1000 M1K40 camera: row segments with trailers, which may begin within a plane.

A plane is 1000 rows of two 64-byte segments: 500 pixel bits and a trailer of 12, least significant bit first, top row
first. The last two bytes of a segment are a little-endian word v: line = (v >> 4) & 0x3FF (1 to 500), channel =
v >> 14 (0 to 3). Line 500 of channel 0 begins a plane and line 500 of channel 3 ends it; the order in between is that
of the first whole plane of the file. Planes carry no number, so whole planes lost before the file leave no trace.

Letters: N segments, S = 2000 segments of a plane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack

SIDE, SEGMENT_BYTES, SEGMENT_PIXELS, SEGMENTS = 1000, 64, 500, 2000
LAYOUT = PlaneLayout(SIDE, SIDE, "lsb", "top")  # layout of the decoded planes
_NAMES = 1 << 12  # number of names: 10 bits of line and 2 of channel
_FIRST, _LAST = 500, 500 | 3 << 10  # names of the segments that begin and end a plane
_MOST_SEGMENTS = (1 << 31) - 1  # 137 GB
_STEP = 1 << 13  # segments that are looked at together
_SEARCHED_BYTES = 1 << 24  # bytes searched for the alignment: 131 planes


@dataclass(frozen=True, eq=False)
class M1K40Stream:
    """The place of every segment of a raw stream; `window` decodes planes. Build with `locate`.

    `data` [n] is the whole file. Segment `index[i]` of `segments` [N, 64] goes to `place[i]` of plane `plane[i]`, in
    rising order: ten bytes of memory for 64 of the file. `skipped_bytes` lie before the first plane and `partial_bytes`
    behind the last; `missing` counts the segments that are lost or unreadable, by plane: their pixels are zero.
    """

    layout: ClassVar = LAYOUT  # of the planes that come out
    data: NDArray[np.uint8]
    segments: NDArray[np.uint8]
    index: NDArray[np.int32]
    plane: NDArray[np.int32]
    place: NDArray[np.int16]
    skipped_bytes: int
    partial_bytes: int
    missing: dict[int, int]

    def __len__(self) -> int:
        return int(self.plane[-1]) + 1

    def window(self, first: int, last: int) -> NDArray[np.uint8]:
        """Decode plain packed planes [last - first, 125000] of `LAYOUT`."""
        bounds = np.searchsorted(self.plane, (first, last))
        part = slice(int(bounds[0]), int(bounds[1]))
        stored = np.zeros((last - first, SEGMENTS, SEGMENT_BYTES), dtype=np.uint8)
        stored[self.plane[part] - first, self.place[part]] = self.segments[self.index[part]]
        bits = np.unpackbits(stored, axis=2, bitorder="little")[:, :, :SEGMENT_PIXELS]
        return pack(bits.reshape(last - first, SIDE, SIDE), LAYOUT)

    def since(self, first: int) -> M1K40Stream:
        """Return planes [first, T) as a stream of their own."""
        at = int(np.searchsorted(self.plane, first))
        return replace(
            self,
            index=self.index[at:],
            plane=self.plane[at:] - np.int32(first),
            place=self.place[at:],
            skipped_bytes=self.skipped_bytes + int(self.index[at] - self.index[0]) * SEGMENT_BYTES,
            missing={plane - first: lost for plane, lost in self.missing.items() if plane >= first},
        )


def locate(data: NDArray[np.uint8]) -> M1K40Stream:
    """Find the planes in the bytes of a file [n]; raises BadRecordingError where there is no whole one."""
    start = _alignment(data)
    segments = _cut(data, start)
    names = _names(segments)
    places = _places_by_name(names)[names]
    index = np.flatnonzero(_trusted(places)).astype(np.int32)
    place = places[index]
    plane = _planes(index, place)
    inside = slice(*np.searchsorted(plane, (0, plane[-1] + (place[-1] == SEGMENTS - 1))))  # they rise
    index, plane, place = index[inside], plane[inside], place[inside]
    found = np.diff(np.searchsorted(plane, np.arange(plane[-1] + 2)))
    return M1K40Stream(
        data,
        segments,
        index,
        plane,
        place,
        start + int(index[0]) * SEGMENT_BYTES,
        len(data) - start - (int(index[-1]) + 1) * SEGMENT_BYTES,
        {int(p): int(SEGMENTS - found[p]) for p in np.flatnonzero(found < SEGMENTS)},
    )


def _cut(data: NDArray[np.uint8], start: int) -> NDArray[np.uint8]:
    """Return the whole segments [N, 64] from byte `start` on."""
    count = max(0, len(data) - start) // SEGMENT_BYTES
    if count > _MOST_SEGMENTS:
        raise BadRecordingError(f"found {count} segments", f"at most {_MOST_SEGMENTS}", "split the file")
    return data[start : start + count * SEGMENT_BYTES].reshape(count, SEGMENT_BYTES)


def _names(segments: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Return line | channel << 10 of every segment [N]."""
    words = segments[:, 62] | segments[:, 63].astype(np.uint16) << 8
    return (words >> 4).astype(np.uint16, copy=False)


def _alignment(data: NDArray[np.uint8]) -> int:
    """Find where segments begin: the byte offset below 64 at which most planes follow one another."""
    counts = []
    for start in range(SEGMENT_BYTES):
        names = _names(_cut(data[:_SEARCHED_BYTES], start))
        counts.append(int(((names[:-1] == _LAST) & (names[1:] == _FIRST)).sum()))
    if not max(counts):
        found = f"found no end of a plane followed by the start of one in {len(data)} bytes"
        raise BadRecordingError(found, "an M1K40 stream of at least two planes", "give the right --format")
    return counts.index(max(counts))


def _places_by_name(names: NDArray[np.uint16]) -> NDArray[np.int16]:
    """Return the place 0 to S - 1 in a plane of each name [_NAMES], -1 for unknown, as the first whole plane has it."""
    for start in np.flatnonzero(names == _FIRST):
        inside = names[start : start + SEGMENTS]
        if len(inside) == SEGMENTS and inside[-1] == _LAST and len(np.unique(inside)) == SEGMENTS:
            places = np.full(_NAMES, -1, dtype=np.int16)
            places[inside] = np.arange(SEGMENTS)
            return places
    found = f"found no plane with all its {SEGMENTS} segments"
    raise BadRecordingError(found, "at least one", "the file is damaged throughout")


def _trusted(places: NDArray[np.int16]) -> NDArray[np.bool_]:
    """Tell which segments [N] follow the one before or lead to the next; the trailers of the others may be damaged."""
    follows = (places[:-1] >= 0) & (places[1:] == (places[:-1] + 1) % SEGMENTS)
    return np.r_[False, follows] | np.r_[follows, False]


def _planes(index: NDArray[np.int32], place: NDArray[np.int16]) -> NDArray[np.int32]:
    """Return the plane of each segment [N], -1 before the first start, counting planes by the segments between."""
    planes = np.empty(len(index), dtype=np.int32)
    planes[0] = -1 if place[0] else 0
    for first in range(0, len(index) - 1, _STEP):
        steps, between = (np.diff(each[first : first + _STEP + 1]) for each in (place, index))
        passed = np.maximum(steps <= 0, np.rint((between - steps) / SEGMENTS))
        planes[first + 1 : first + 1 + len(passed)] = planes[first] + np.cumsum(passed)
    return planes
