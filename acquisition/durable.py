"""Files that are whole or absent: written aside, flushed to disk, renamed."""

import io
import json
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import DiskError


def write_durably(path: Path, data: bytes | str) -> None:
    """Put `data` (text as UTF-8) under `path`; raises DiskError, and leaves `path` as it was, when the disk refuses."""
    raw = data.encode() if isinstance(data, str) else data
    aside = path.with_name(f".{path.name}.{os.getpid()}.partial")  # two processes may write the same name
    try:
        with aside.open("wb") as file:
            file.write(raw)
            file.flush()
            os.fsync(file.fileno())
        aside.replace(path)
    except OSError as error:
        aside.unlink(missing_ok=True)
        raise DiskError(
            f"{path}: cannot be written ({error.strerror}), expected room and permission for {len(raw)} bytes"
        ) from error


def write_json(path: Path, document: object) -> None:
    """`document` as indented JSON under `path`, durably."""
    write_durably(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def write_array(path: Path, array: NDArray) -> None:
    """`array` as .npy under `path`, durably."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    write_durably(path, buffer.getvalue())
