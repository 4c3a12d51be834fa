"""The data folder: where recordings, runs, logs and locks lie.

DATA/dbos.sqlite, DATA/catalogue.sqlite   the databases, unless PostgreSQL has them
DATA/captures/CID/                        a recording
DATA/jobs/JID/run/, DATA/jobs/JID/out/    the run folder of a reconstruction; what any other job made
DATA/entries/ID/log.txt                   what the stages of a capture or job wrote; its flock is held while one runs
DATA/entries/ID/parts/                    its flock is shared by the processes of parts of a training
DATA/rigs/RIG/                            held by flock while the rig records; its calibrations as files
DATA/uploads/UID/                         what was uploaded so far
DATA/.removed-*/                          what is being deleted, or was when its process was killed
DATA/reserve                              room that is given up where the disk is full, so that it can be emptied
"""

import fcntl
import json
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_REMOVED, _LEFT_S = ".removed-", 3600.0  # where a folder is put aside to be deleted, and when that was left undone


class DataFolder:
    """Paths under a data folder, which processes on several hosts may share."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._place = _place_of(path)
        for name in ("captures", "jobs", "entries", "rigs", "uploads"):
            (path / name).mkdir(parents=True, exist_ok=True)

    def entry(self, entry_id: str) -> Path:
        """Return the folder of an entry's log, made where it is missing."""
        folder = self.path / "entries" / entry_id
        folder.mkdir(exist_ok=True)
        return folder

    def hidden(self, text: str) -> str:
        """Return a text that others may read: names inside the folder, and not where it lies on this machine."""
        return self._place.sub(lambda found: "" if found[1] else "the data folder", text)

    def parts(self, entry_id: str) -> Path:
        """Return the folder whose flock the processes of a training's parts share, made where it is missing."""
        folder = self.entry(entry_id) / "parts"
        folder.mkdir(exist_ok=True)
        return folder

    def has_process(self, entry_id: str) -> bool:
        """Return whether a process of an entry is alive on this host."""
        folder = self.path / "entries" / entry_id
        return is_locked(folder) or is_locked(folder / "parts")

    def log(self, entry_id: str) -> Path:
        """Return the path that the stages of an entry wrote."""
        return self.path / "entries" / entry_id / "log.txt"

    def logged(self, entry_id: str) -> str:
        """Return what the stages of an entry wrote so far."""
        path = self.log(entry_id)
        return self.hidden(path.read_text(errors="replace")) if path.exists() else ""

    def recording(self, capture_id: str) -> Path:
        """Return the recording folder of a capture."""
        return self.path / "captures" / capture_id

    def begun(self, capture_id: str) -> Path:
        """Return the mark of a capture that a worker has begun to record."""
        return self.entry(capture_id) / "begun"

    def job(self, job_id: str) -> Path:
        """Return the folder of a job."""
        return self.path / "jobs" / job_id

    def run(self, job_id: str) -> Path:
        """Return the run folder of a reconstruction."""
        return self.job(job_id) / "run"

    def out(self, job_id: str) -> Path:
        """Return the folder that any other job writes."""
        return self.job(job_id) / "out"

    def rig(self, rig_id: str) -> Path:
        """Return the folder whose flock is held while a rig records."""
        folder = self.path / "rigs" / rig_id
        folder.mkdir(exist_ok=True)
        return folder

    def upload(self, upload_id: str) -> Path:
        """Return the folder of an upload."""
        return self.path / "uploads" / upload_id

    def received(self, upload_id: str) -> int:
        """Return how many bytes of an upload have come."""
        try:
            return (self.upload(upload_id) / "data").stat().st_size
        except FileNotFoundError:  # it is being deleted
            return 0

    def sweep(self) -> None:
        """Delete what a process that was killed while it removed a folder has left."""
        for aside in self.path.glob(f"{_REMOVED}*"):
            with suppress(FileNotFoundError):  # it has just gone
                if time.time() - aside.stat().st_mtime > _LEFT_S:
                    shutil.rmtree(aside, ignore_errors=True)

    def remove(self, folder: Path) -> None:
        """Delete a folder, which leaves its place at once, whatever its size."""
        if folder.exists():
            with self.removing(folder):
                pass

    @contextmanager
    def removing(self, *folders: Path) -> Iterator[None]:
        """Delete folders: they leave their places before the block, and have them back where it raises.

        Those of a process that is killed meanwhile lie where `sweep` looks.
        """
        aside = Path(tempfile.mkdtemp(prefix=_REMOVED, dir=self.path))
        moved: dict[Path, Path] = {}
        try:
            for number, folder in enumerate(folders):
                with suppress(FileNotFoundError):  # there is none, or another request was faster
                    there = folder.rename(aside / str(number))
                    moved[there] = folder
            yield
        except BaseException:
            for there, folder in moved.items():
                there.rename(folder)
            aside.rmdir()
            raise
        shutil.rmtree(aside)


def _place_of(path: Path) -> re.Pattern[str]:
    """Return the pattern of a path as texts and JSON have it, with a slash behind it or none.

    It does not fit the end of another path, nor the beginning of a longer name. In JSON a line break is `\\n`.
    """
    names = "|".join(map(re.escape, dict.fromkeys((str(path), json.dumps(str(path))[1:-1]))))
    return re.compile(rf"(?:(?<![\w.~-])|(?<=\\[nrt]))(?:{names})(?:(/)|(?![\w-]|\.\w))")


def make_private(folder: Path) -> None:
    """Make a folder that only its owner enters; one that another user owns stays as it is."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder.stat().st_uid == os.geteuid():
        folder.chmod(0o700)


@contextmanager
def locked(path: Path, flags: int = os.O_RDONLY, *, wait: bool = False) -> Iterator[int]:
    """Hold the flock of a file or folder; yields a descriptor of it.

    Raises BlockingIOError where another process holds it, unless told to `wait` for that.
    """
    descriptor = os.open(path, flags, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        yield descriptor
    finally:
        os.close(descriptor)


@contextmanager
def shared(path: Path) -> Iterator[int]:
    """Hold the flock of a folder beside others who share it; yields a descriptor of it.

    Raises BlockingIOError where one process has it alone.
    """
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        yield descriptor
    finally:
        os.close(descriptor)


def is_locked(folder: Path) -> bool:
    """Return whether some process holds the folder's flock."""
    try:
        with locked(folder):
            return False
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
