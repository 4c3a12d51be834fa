"""Packs spike planes into bytes and back, and counts spikes straight from the packed bytes.

Letters: T planes, H rows (row 0 at the top), W columns, B bytes of a plane, N windows.
"""

import ctypes
import mmap

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError
from acquisition.native import Address, Kernel
from acquisition.spikes.compact import CompactPlanes
from acquisition.spikes.layout import PlaneLayout

Bytes = NDArray[np.uint8]
Planes = Bytes | CompactPlanes
PIECE_BYTES = 16 << 20  # of a mapped file, read at a time
_SIZE = (ctypes.c_int32,) * 4  # stored width, height, whether MSB first, whether bottom row first
PLANES = (Address, ctypes.c_int64, *_SIZE)  # argument types that go with `plane_arguments`
_unpack_planes = Kernel("acquisition", "unpack_planes", *PLANES, Address)
_count_windows = Kernel(
    "acquisition", "count_windows", Address, *_SIZE, Address, ctypes.c_int64, ctypes.c_int32, Address
)


def pack(planes: NDArray, layout: PlaneLayout) -> Bytes:
    """Pack planes [T, H, W] (non-zero is a spike) into bytes [T, B]; trailing columns become zero.

    Raises BadRecordingError where the planes have another size than the layout.
    """
    if planes.ndim != 3 or planes.shape[1:] != (layout.height, layout.width):
        raise BadRecordingError(f"found planes {planes.shape}", f"(T, {layout.height}, {layout.width})")
    rows = planes[:, ::-1] if layout.row_order == "bottom" else planes
    stored = np.pad(rows != 0, ((0, 0), (0, 0), (0, layout.trailing_columns)))
    bits = stored.reshape(len(planes), layout.height * layout.stored_width)
    return np.packbits(bits, axis=1, bitorder="little" if layout.bit_order == "lsb" else "big")


def unpack_reference(packed: Bytes, layout: PlaneLayout) -> Bytes:
    """Unpack bytes [T, B] into planes [T, H, W] of 0 and 1 in NumPy: the definition of the format."""
    bits = np.unpackbits(packed, axis=1, bitorder="little" if layout.bit_order == "lsb" else "big")
    stored = bits[:, : layout.height * layout.stored_width].reshape(len(packed), layout.height, layout.stored_width)
    planes = stored[:, :, : layout.width]
    return np.ascontiguousarray(planes[:, ::-1] if layout.row_order == "bottom" else planes)


def unpack(packed: Bytes, layout: PlaneLayout) -> Bytes:
    """Unpack bytes [T, B] into planes [T, H, W] of 0 and 1; native twin of `unpack_reference`."""
    out = np.empty((len(packed), layout.height, layout.stored_width), dtype=np.uint8)
    _unpack_planes(*plane_arguments(packed, layout), out)
    return without_trailing(out, layout)


def counts(packed: Planes, layout: PlaneLayout) -> NDArray[np.uint32]:
    """Count the spikes of each pixel [H, W] over all packed planes [T, B]."""
    return window_counts(packed, layout, np.array([[0, len(packed)]]))[0]


def window_counts(packed: Planes, layout: PlaneLayout, bounds: NDArray, *, threads: int = 1) -> NDArray[np.uint32]:
    """Count the spikes of each pixel [N, H, W] over planes [first, last) of each row of `bounds` [N, 2].

    Raises BadRecordingError for a window that is not inside the planes [T, B].
    """
    bounds = np.ascontiguousarray(bounds, dtype=np.int64).reshape(-1, 2)
    outside = (bounds[:, 0] < 0) | (bounds[:, 1] < bounds[:, 0]) | (bounds[:, 1] > len(packed))
    if outside.any():
        first, last = bounds[outside][0]
        raise BadRecordingError(f"found planes {first}:{last}", f"a window inside 0:{len(packed)}")
    pieces = _pieces(packed, int(bounds[:, 0].min(initial=len(packed))), int(bounds[:, 1].max(initial=0)))
    if pieces or isinstance(packed, CompactPlanes):
        return _counts_by_piece(packed, pieces, layout, bounds, threads)
    out = np.empty((len(bounds), layout.height, layout.stored_width), dtype=np.uint32)
    data, _, *size = plane_arguments(packed, layout)
    _count_windows(data, *size, bounds, len(bounds), threads, out)
    return without_trailing(out, layout)


def _pieces(packed: Planes, first: int, last: int) -> list[tuple[int, int]]:
    """Return the pieces of planes [first, last) that are read one after another; none where they are read at once."""
    if isinstance(packed, CompactPlanes):
        return list(packed.spans(first, last))
    if not is_mapped(packed) or (last - first) * packed.shape[1] <= PIECE_BYTES:
        return []
    step = max(1, PIECE_BYTES // packed.shape[1])
    return [(start, min(last, start + step)) for start in range(first, last, step)]


def _counts_by_piece(
    packed: Planes, pieces: list[tuple[int, int]], layout: PlaneLayout, bounds: NDArray, threads: int
) -> NDArray[np.uint32]:
    """Count as `window_counts` does, one piece after another, each read or decoded once."""
    out = np.zeros((len(bounds), layout.height, layout.width), dtype=np.uint32)
    for first, last in pieces:
        inside = np.clip(bounds, first, last) - first
        touched = inside[:, 1] > inside[:, 0]
        if touched.any():
            out[touched] += window_counts(packed[first:last], layout, inside[touched], threads=threads)
        let_go(packed)
    return out


def is_mapped(packed: Planes) -> bool:
    """Return whether planes lie in a file that is mapped into memory."""
    return getattr(packed, "_mmap", None) is not None


def let_go(packed: Planes) -> None:
    """Hand the pages of a mapped file that were read back: the system keeps them as long as it has room.

    They are read again as if nothing had happened. Without it, a process that has been through a long recording holds
    all of it.
    """
    if is_mapped(packed):
        packed._mmap.madvise(mmap.MADV_DONTNEED)  # pyright: ignore[reportAttributeAccessIssue]


def window_means(packed: Planes, layout: PlaneLayout, bounds: NDArray, *, threads: int = 1) -> NDArray[np.float32]:
    """Return spikes per tick [N, H, W] over planes [first, last), at least one, of each row of `bounds` [N, 2].

    Raises BadRecordingError for a window that is empty or not inside the planes [T, B].
    """
    found, lengths = window_counts(packed, layout, bounds, threads=threads), np.diff(bounds)[:, :, None]
    if not lengths.all():
        raise BadRecordingError("found a window without planes", "at least one")
    return found.astype(np.float32) / lengths.astype(np.float32)


def without_trailing(stored: NDArray, layout: PlaneLayout) -> NDArray:
    """Return images [..., H, stored width] without their trailing columns, [..., H, W]."""
    return np.ascontiguousarray(stored[..., : layout.width])


def plane_arguments(packed: Bytes, layout: PlaneLayout) -> tuple[Bytes, int, int, int, int, int]:
    """Return planes [T, B] and their layout as a kernel declared with `PLANES` takes them.

    Raises BadRecordingError where the planes are not [T, B] bytes of the layout.
    """
    if packed.dtype != np.uint8 or packed.ndim != 2 or packed.shape[1] != layout.plane_bytes:
        raise BadRecordingError(f"found packed planes {packed.shape}", f"(T, {layout.plane_bytes}) bytes")
    orders = layout.bit_order == "msb", layout.row_order == "bottom"
    return np.ascontiguousarray(packed), len(packed), layout.stored_width, layout.height, *orders
