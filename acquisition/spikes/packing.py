"""Spike planes to bytes and back, and counts over them; the fast kernels and their readable reference.

Letters: T planes, H rows (row 0 at the top), W columns, B bytes of a plane.
"""

import ctypes

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError
from acquisition.native import load_library
from acquisition.spikes.layout import PlaneLayout

Bytes = NDArray[np.uint8]


def pack(planes: NDArray, layout: PlaneLayout) -> Bytes:
    """Planes [T, H, W] (non-zero is a spike) to packed bytes [T, B]; trailing columns are zero."""
    if planes.ndim != 3 or planes.shape[1:] != (layout.height, layout.width):
        raise BadRecordingError(f"found planes {planes.shape}", f"(T, {layout.height}, {layout.width})")
    rows = planes[:, ::-1] if layout.row_order == "bottom" else planes
    stored = np.pad(rows != 0, ((0, 0), (0, 0), (0, layout.trailing_columns)))
    bits = stored.reshape(len(planes), layout.height * layout.stored_width)
    return np.packbits(bits, axis=1, bitorder="little" if layout.bit_order == "lsb" else "big")


def unpack_reference(packed: Bytes, layout: PlaneLayout) -> Bytes:
    """Packed bytes [T, B] to planes [T, H, W] of 0 and 1: the definition of the format, in NumPy."""
    bits = np.unpackbits(packed, axis=1, bitorder="little" if layout.bit_order == "lsb" else "big")
    stored = bits[:, : layout.height * layout.stored_width].reshape(len(packed), layout.height, layout.stored_width)
    planes = stored[:, :, : layout.width]
    return np.ascontiguousarray(planes[:, ::-1] if layout.row_order == "bottom" else planes)


def counts_reference(packed: Bytes, layout: PlaneLayout) -> NDArray[np.uint32]:
    """Spikes of each pixel [H, W] over packed planes [T, B], in NumPy."""
    return unpack_reference(packed, layout).sum(axis=0, dtype=np.uint32)


def unpack(packed: Bytes, layout: PlaneLayout) -> Bytes:
    """Packed bytes [T, B] to planes [T, H, W] of 0 and 1; native twin of `unpack_reference`."""
    out = np.empty((len(packed), layout.height, layout.stored_width), dtype=np.uint8)
    load_library("acquisition").unpack_planes(*native_arguments(packed, layout), pointer(out))
    return np.ascontiguousarray(out[:, :, : layout.width])


def counts(packed: Bytes, layout: PlaneLayout) -> NDArray[np.uint32]:
    """Spikes of each pixel [H, W] over packed planes [T, B]; native twin of `counts_reference`."""
    out = np.empty((layout.height, layout.stored_width), dtype=np.uint32)
    data, planes, *size = native_arguments(packed, layout)
    bounds = (ctypes.c_int64 * 2)(0, planes.value)
    load_library("acquisition").count_windows(data, *size, bounds, ctypes.c_int64(1), ctypes.c_int32(1), pointer(out))
    return out if layout.trailing_columns == 0 else np.ascontiguousarray(out[:, : layout.width])


def window_counts(packed: Bytes, layout: PlaneLayout, bounds: NDArray, *, threads: int = 1) -> NDArray[np.uint32]:
    """Spikes of each pixel [N, H, W] over planes [first, last) of each row of `bounds` [N, 2], by `threads` cores.

    Raises BadRecordingError for a window that is not inside the planes [T, B].
    """
    out = np.empty((len(bounds), layout.height, layout.stored_width), dtype=np.uint32)
    load_library("acquisition").count_windows(*_window_arguments(packed, layout, bounds, 0), threads, pointer(out))
    return np.ascontiguousarray(out[:, :, : layout.width])


def window_means(packed: Bytes, layout: PlaneLayout, bounds: NDArray, *, threads: int = 1) -> NDArray[np.float32]:
    """`window_counts` over the planes of each window, of which there is at least one: spikes per tick [N, H, W]."""
    out = np.empty((len(bounds), layout.height, layout.stored_width), dtype=np.float32)
    load_library("acquisition").mean_windows(*_window_arguments(packed, layout, bounds, 1), threads, pointer(out))
    return np.ascontiguousarray(out[:, :, : layout.width])


def _window_arguments(packed: Bytes, layout: PlaneLayout, bounds: NDArray, least: int) -> tuple:
    bounds = np.ascontiguousarray(bounds, dtype=np.int64).reshape(-1, 2)
    outside = (bounds[:, 0] < 0) | (bounds[:, 1] < bounds[:, 0] + least) | (bounds[:, 1] > len(packed))
    if outside.any():
        first, last = bounds[outside][0]
        raise BadRecordingError(f"found planes {first}:{last}", f"a window inside 0:{len(packed)}")
    data, _, *size = native_arguments(packed, layout)
    return data, *size, pointer(bounds), ctypes.c_int64(len(bounds))


def pointer(array: NDArray) -> ctypes.c_void_p:
    """Where the first element lies, for a native kernel; keeps the array alive."""
    return array.ctypes.data_as(ctypes.c_void_p)


def native_arguments(packed: Bytes, layout: PlaneLayout) -> tuple:
    """Data, number of planes, stored width, height, MSB first and bottom row first, as every native kernel takes them.

    Raises BadRecordingError where the planes are not [T, B] bytes of the layout.
    """
    if packed.dtype != np.uint8 or packed.ndim != 2 or packed.shape[1] != layout.plane_bytes:
        raise BadRecordingError(f"found packed planes {packed.shape}", f"(T, {layout.plane_bytes}) bytes")
    contiguous = np.ascontiguousarray(packed)
    return (
        pointer(contiguous),
        ctypes.c_int64(len(packed)),
        ctypes.c_int32(layout.stored_width),
        ctypes.c_int32(layout.height),
        ctypes.c_int32(layout.bit_order == "msb"),
        ctypes.c_int32(layout.row_order == "bottom"),
    )
