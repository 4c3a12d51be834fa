"""A memory-mapped `.dat` or compact file, of which only the window asked for is ever unpacked."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError
from acquisition.spikes import packing
from acquisition.spikes.compact import SUFFIX, CompactPlanes
from acquisition.spikes.intervals import outermost
from acquisition.spikes.layout import PlaneLayout

MOST_LIGHT = 1.0  # spikes per tick: no pixel fires more than once in one


class SpikeStream:
    """The planes of one camera, by index from 0; `tick_rate_hz` turns counts into light.

    Build with `open`. `partial_bytes` counts the bytes of a truncated file beyond its last whole plane.
    """

    def __init__(self, packed: packing.Planes, layout: PlaneLayout, tick_rate_hz: float, partial_bytes: int = 0):
        self.packed = cast(packing.Bytes, packed)  # [T, B]; of a compact file an index decodes what it touches
        self.layout = layout
        self.tick_rate_hz = tick_rate_hz
        self.partial_bytes = partial_bytes

    @classmethod
    def open(cls, path: Path, layout: PlaneLayout, tick_rate_hz: float, *, allow_partial: bool = False) -> SpikeStream:
        """Map `path`; raises BadRecordingError when it is missing, empty, or (unless allowed) ends inside a plane."""
        if not tick_rate_hz > 0:
            raise BadRecordingError(f"found the tick rate {tick_rate_hz} Hz", "a positive number")
        if path.suffix == SUFFIX or (not path.exists() and path.with_suffix(SUFFIX).exists()):
            do = "name its recording, or call `spike4dgs compact --undo` on it"
            raise BadRecordingError("found it compact", "a .dat", do, where=path)
        with BadRecordingError.reading(path, "give an existing .dat"), path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
        planes, partial = divmod(size, layout.plane_bytes)
        expected = f"{layout.plane_bytes} bytes a plane of {layout.width}x{layout.height}"
        if partial and not allow_partial:
            found = f"found {size} bytes, {partial} more than {planes} whole planes ({expected})"
            raise BadRecordingError(found, do="give the right size, or allow a partial last plane", where=path)
        if planes == 0:
            raise BadRecordingError(f"found {size} bytes", f"at least one plane ({expected})", where=path)
        mapped = np.memmap(path, dtype=np.uint8, mode="r", shape=(planes, layout.plane_bytes))
        return cls(mapped, layout, tick_rate_hz, partial)

    def __len__(self) -> int:
        return len(self.packed)

    @cached_property
    def outermost(self) -> NDArray[np.uint16]:
        """The whole intervals [2, H, W] near the first and the last plane, in ticks, by `intervals.outermost`."""
        return outermost(self.packed, self.layout)

    def window(self, first: int, last: int) -> NDArray[np.uint8]:
        """Return packed planes [last - first, B]; raises BadRecordingError outside the stream."""
        if not 0 <= first <= last <= len(self):
            raise BadRecordingError(f"found planes {first}:{last}", f"a window inside 0:{len(self)}")
        return self.packed[first:last]

    def around(self, plane: int, reach: int) -> tuple[int, int]:
        """Return the planes [first, last) within `reach` of `plane`, cut at the ends; refuse a plane outside."""
        if not 0 <= plane < len(self):
            raise BadRecordingError(f"found the instant at plane {plane}", f"one inside 0:{len(self)}")
        return max(0, plane - reach), min(len(self), plane + reach + 1)

    def let_go(self) -> None:
        """Hand what was read of a mapped file back to the system; it is read again where it is asked for."""
        packing.let_go(self.packed)

    def mapped(self, first: int, last: int) -> SpikeStream:
        """Return planes [first, last) as `part` does, but read nothing, not even of a compact file."""
        packed: packing.Planes = self.packed
        if isinstance(packed, CompactPlanes) and 0 <= first <= last <= len(self):
            return SpikeStream(packed.part(first, last), self.layout, self.tick_rate_hz)
        return self.part(first, last)

    def part(self, first: int, last: int) -> SpikeStream:
        """Return planes [first, last) as a stream of their own; raises BadRecordingError outside the stream."""
        return SpikeStream(self.window(first, last), self.layout, self.tick_rate_hz)

    def since(self, first: int) -> SpikeStream:
        """Return planes [first, T) as a stream of their own, and what is behind the last one."""
        return SpikeStream(self.window(first, len(self)), self.layout, self.tick_rate_hz, self.partial_bytes)

    def planes(self, first: int, last: int) -> NDArray[np.uint8]:
        """Unpack planes [last - first, H, W] of 0 and 1, row 0 at the top."""
        return packing.unpack(self.window(first, last), self.layout)

    def counts(self, first: int, last: int) -> NDArray[np.uint32]:
        """Count the spikes of each pixel [H, W] over planes [first, last)."""
        return self.window_counts([(first, last)])[0]

    def window_counts(self, windows: Sequence[tuple[int, int]]) -> NDArray[np.uint32]:
        """Count the spikes of each pixel [N, H, W] over the planes [first, last) of each of N windows."""
        return packing.window_counts(self.packed, self.layout, np.array(windows, dtype=np.int64))
