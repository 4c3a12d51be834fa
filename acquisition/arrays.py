"""Writes and reads NumPy's files of arrays.

NumPy parses the header of an array as Python. Before 3.11.8, Python raises SystemError where two threads parse at once
(https://github.com/python/cpython/issues/106905), so threads read one after another.
"""

import io
from pathlib import Path
from threading import RLock

import numpy as np
from numpy.typing import NDArray

from acquisition.durable import write_durably

_PARSER = RLock()  # a finaliser that runs while a header is parsed may read as well


def write_array(path: Path, array: NDArray) -> None:
    """Write `array` to `path` as .npy, whole or not at all; raises DiskError when the disk refuses."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    write_durably(path, buffer.getvalue())


def read_array(path: Path) -> NDArray:
    """Return the array of a .npy file; raises OSError, ValueError or EOFError where there is none."""
    with _PARSER:
        return np.load(path, allow_pickle=False)


def map_array(path: Path) -> NDArray:
    """Return the array of a .npy file mapped into memory, for reading alone; raises as `read_array`."""
    with _PARSER:
        return np.load(path, mmap_mode="r", allow_pickle=False)


def read_arrays(path: Path) -> dict[str, NDArray]:
    """Return the arrays of an .npz file by name; a file that is none may raise nearly anything."""
    with _PARSER, np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}
