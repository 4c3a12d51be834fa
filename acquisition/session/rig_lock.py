"""Lets one operator at a time record with a rig, by a lock."""

import contextlib
import fcntl
import getpass
import os
import re
from collections.abc import Iterator
from pathlib import Path

from acquisition.errors import RigBusyError

LOCK_FOLDER = "SPIKE4DGS_LOCKS"  # the environment's name for another folder than /run/lock or /tmp


@contextlib.contextmanager
def rig_lock(name: str, out: Path) -> Iterator[None]:
    """Hold the rig `name` of this machine while recording into `out`; the lock ends with the process.

    Raises RigBusyError naming the rig and who holds it.
    """
    path = _folder() / f"spike4dgs-{re.sub(r'[^A-Za-z0-9_.-]', '_', name)}.lock"
    handle = _open(path)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.pread(handle, 500, 0).decode(errors="replace").strip() or "another process"
            raise RigBusyError(
                f"found it in use by {holder}", "it free", "wait for that run to end, or stop it", where=f"rig {name}"
            ) from error
        with contextlib.suppress(OSError):  # another user's file can be locked but not written
            os.ftruncate(handle, 0)
            os.pwrite(handle, f"{_user()} (process {os.getpid()}, recording {out})\n".encode(), 0)
        yield
    finally:
        os.close(handle)


def _folder() -> Path:
    chosen = os.environ.get(LOCK_FOLDER)
    if chosen:
        return Path(chosen)
    return Path("/run/lock") if os.access("/run/lock", os.W_OK | os.X_OK) else Path("/tmp")


def _open(path: Path) -> int:
    """Open the file for whoever may read it: with O_CREAT the kernel refuses another user's file in a shared folder."""
    for flags in (os.O_RDWR, os.O_RDONLY, os.O_RDWR | os.O_CREAT):
        with contextlib.suppress(FileNotFoundError, PermissionError):
            handle = os.open(path, flags | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
            if flags & os.O_CREAT:
                os.fchmod(handle, 0o666)
            return handle
    raise RigBusyError("cannot be opened", "a file every operator may lock", f"set {LOCK_FOLDER}", where=path)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"user {os.getuid()}"
