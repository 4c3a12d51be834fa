"""Copies what a service knows, while it runs, and puts it back: databases, calibrations and logs, no recordings."""

import json
import shutil
import sqlite3
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from acquisition.durable import flush, made_aside, write_json
from server.errors import ServiceError
from server.settings import ServiceSettings
from server.store.files import DataFolder, locked
from server.store.soundness import DATABASES, expect_whole

FORMAT = 1
_DOCUMENT = "backup.json"
_FOLDERS = ("rigs", "entries")
_NOT_COPIED = (".lock", ".partial")


class BackupError(ServiceError):
    """A backup cannot be made here, is none, or cannot be put back now."""

    exit_code = 2


class Orphans(NamedTuple):
    """Recordings and runs in a data folder that no entry of its catalogue names: they are newer than the backup."""

    captures: list[str]
    jobs: list[str]


def back_up(settings: ServiceSettings, out: Path) -> None:
    """Copy what the service over `settings.data` knows into the new folder `out`; the service may be at work.

    Raises BackupError where the database is a server's, DatabaseError where it is damaged, DiskError.
    """
    if settings.database is not None:
        raise BackupError("found a PostgreSQL database", "SQLite files", "back it up with pg_dump and pg_restore")
    if out.exists():
        raise BackupError("found it already", "a new folder", "choose another name", where=out)
    for name in DATABASES:
        expect_whole(settings.data / name)
    with made_aside(out) as folder:
        folder.mkdir(mode=0o700)
        for name in DATABASES:  # the engine's first: what is kept but unknown to it is queued again
            with (
                closing(sqlite3.connect(settings.data / name)) as source,
                closing(sqlite3.connect(folder / name)) as to,
            ):
                source.backup(to)
        for name in _FOLDERS:
            _copy_live(settings.data / name, folder / name)
        write_json(folder / _DOCUMENT, {"format": FORMAT, "made": datetime.now(UTC).isoformat("T", "seconds")})


def restore(backup: Path, settings: ServiceSettings) -> tuple[Path | None, Orphans]:
    """Put a backup's databases into `settings.data`, and whatever of its calibrations and logs is missing there.

    Returns the folder to which the databases that were there have been moved, and what the backup does not know.
    Raises BackupError where `backup` is none or the service or a worker is at work, DatabaseError where it is damaged.
    """
    if settings.database is not None:
        raise BackupError("found a PostgreSQL database", "SQLite files", "restore it with pg_restore")
    _expect_backup(backup)
    data = DataFolder(settings.data)
    try:
        with locked(data.path):
            incoming = [(data.path / f".{name}.partial", data.path / name) for name in DATABASES]
            for aside, path in incoming:
                shutil.copyfile(backup / path.name, aside)
                flush(aside)
            replaced = _move_away(data.path)
            for aside, path in incoming:
                aside.rename(path)
            for name in _FOLDERS:
                _copy_missing(backup / name, data.path / name)
            flush(data.path)
            return replaced, _orphans(data.path)
    except BlockingIOError as error:
        raise BackupError("found the service or a worker at work", "both stopped", where=data.path) from error


def _expect_backup(folder: Path) -> None:
    try:
        found = json.loads((folder / _DOCUMENT).read_text())["format"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BackupError("found no backup", "a folder that spike4dgs backup made", where=folder) from error
    if found != FORMAT:
        raise BackupError(
            f"found a backup of format {found}", str(FORMAT), "use the version that made it", where=folder
        )
    for name in DATABASES:
        expect_whole(folder / name)


def _move_away(data: Path) -> Path | None:
    there = [path for name in DATABASES for path in data.glob(f"{name}*")]
    if not there:
        return None
    aside = data / f"replaced-{datetime.now(UTC):%Y%m%d-%H%M%S-%f}"
    aside.mkdir()
    for path in there:
        path.rename(aside / path.name)
    return aside


def _copy_live(source: Path, to: Path) -> None:
    """Copy a folder in which files come and go; what goes meanwhile is left out, and so is what is being written."""
    to.mkdir()
    with suppress(FileNotFoundError):
        for path in sorted(source.iterdir()):
            if path.is_dir():
                _copy_live(path, to / path.name)
            elif path.suffix not in _NOT_COPIED:
                with suppress(FileNotFoundError):
                    shutil.copy2(path, to / path.name)


def _copy_missing(source: Path, to: Path) -> None:
    for path in sorted(source.rglob("*")):
        wanted = to / path.relative_to(source)
        if path.is_dir():
            wanted.mkdir(exist_ok=True)
        elif not wanted.exists():
            shutil.copyfile(path, wanted)
            flush(wanted)


def _orphans(data: Path) -> Orphans:
    with closing(sqlite3.connect(data / "catalogue.sqlite")) as catalogue:
        known = {row[0] for row in catalogue.execute("SELECT id FROM entries")}
    return Orphans(*(sorted({path.name for path in (data / kind).iterdir()} - known) for kind in ("captures", "jobs")))
