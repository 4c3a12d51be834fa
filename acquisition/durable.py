"""Writes files that are whole or absent: written aside, flushed to disk, renamed."""

import errno
import json
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

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


def write_first(folder: int, name: str, data: bytes) -> bool:
    """Write `name` in an open folder unless it is there, whole or absent; return whether this was the first to do so.

    Of processes that write at once, on one host or on several that share the folder, one is the first. Where the
    folder itself was removed meanwhile nothing is written, and False returned. Raises DiskError when the disk refuses.
    """
    aside = f".{name}.{secrets.token_hex(8)}.partial"  # numbers of processes repeat among hosts
    try:
        handle = os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644, dir_fd=folder)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            first = _linked(folder, aside, name)
        finally:
            with suppress(FileNotFoundError):
                os.unlink(aside, dir_fd=folder)
        os.fsync(folder)
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ESTALE):
            return False
        found = f"cannot be written ({error.strerror})"
        raise DiskError(found, f"room and permission for {len(data)} bytes", where=name) from error
    return first


def _linked(folder: int, aside: str, name: str) -> bool:
    """Give a file a second name unless that is taken; return whether it was free.

    An answer that was lost on its way to another host makes the link look taken that was made: the links are counted.
    Where the disk has no links, one host is alone with it.
    """
    try:
        os.link(aside, name, src_dir_fd=folder, dst_dir_fd=folder)
    except FileExistsError:
        return os.stat(aside, dir_fd=folder).st_nlink == 2
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
        if os.access(name, os.F_OK, dir_fd=folder):
            return False
        os.rename(aside, name, src_dir_fd=folder, dst_dir_fd=folder)
    return True


def write_json(path: Path, document: object) -> None:
    """Write `document` to `path` as indented JSON."""
    write_durably(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


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
        raise DiskError(f"cannot be written ({error.strerror or error})", "room and permission", where=path) from error
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
