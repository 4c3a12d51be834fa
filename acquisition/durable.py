"""Writes files that are whole or absent: written aside, flushed to disk, renamed."""

import io
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import DiskError


def write_durably(path: Path, data: bytes | str) -> None:
    """Write `data` (text as UTF-8) to `path`; raises DiskError, and leaves `path` as it was, when the disk refuses."""
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
        found = f"cannot be written ({error.strerror})"
        raise DiskError(found, f"room and permission for {len(raw)} bytes", where=path) from error


def write_json(path: Path, document: object) -> None:
    """Write `document` to `path` as indented JSON."""
    write_durably(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def write_array(path: Path, array: NDArray) -> None:
    """Write `array` to `path` as .npy."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    write_durably(path, buffer.getvalue())


@contextmanager
def made_aside(path: Path) -> Iterator[Path]:
    """Yield a name to make a file or a folder under, which is flushed to disk and renamed `path` when the block ends.

    It replaces the file or the whole folder that was at `path`, which stays as it was when the block raises. Raises
    DiskError when the disk refuses.
    """
    path = path.resolve()
    aside, old = (path.with_name(f".{path.name}.{os.getpid()}.{kind}") for kind in ("partial", "old"))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield aside
        for file in aside.rglob("*") if aside.is_dir() else [aside]:
            if file.is_file():
                flush(file)
        if path.is_dir():
            path.rename(old)
        aside.replace(path)
    except OSError as error:
        if old.exists():
            old.rename(path)
        raise DiskError(f"cannot be written ({error.strerror})", "room and permission", where=path) from error
    finally:
        _remove(aside)
        _remove(old)


def flush(path: Path) -> None:
    """Bring a file, or the names in a folder, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    elif path.exists():
        path.unlink()
