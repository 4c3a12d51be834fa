"""What jobs have made: name, type, size and digest of every file, kept by the worker that made it."""

from __future__ import annotations

import hashlib
import mimetypes
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa

from server.store.tables import artefacts

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*(/[A-Za-z0-9][A-Za-z0-9._-]*){0,3}")
MOST = 5000  # files of one job; more belong into an archive
_TYPES = {
    ".npy": "application/octet-stream",
    ".npz": "application/octet-stream",
    ".bin": "application/octet-stream",
    ".ply": "application/octet-stream",
    ".splat": "application/octet-stream",
    ".spz": "application/octet-stream",
    ".glb": "model/gltf-binary",
    ".toml": "application/toml",
    ".txt": "text/plain",
}


@dataclass(frozen=True)
class StoredArtefact:
    """A file that a job has made."""

    entry: str
    name: str
    media_type: str
    bytes: int
    sha256: str
    modified_ns: str


class Artefacts:
    """The table of artefacts."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def of(self, entry_id: str) -> list[StoredArtefact]:
        """All artefacts of a job, by name."""
        query = sa.select(artefacts).where(artefacts.c.entry == entry_id).order_by(artefacts.c.name)
        with self._engine.connect() as connection:
            return [StoredArtefact(**row) for row in connection.execute(query).mappings()]

    def catalogue(self, entry_id: str, folder: Path, names: Iterator[str]) -> None:
        """Note the files `names` under `folder`; one that did not change is not read again."""
        known = {artefact.name: artefact for artefact in self.of(entry_id)}
        found = [described(entry_id, folder / name, name, known.get(name)) for name in names]
        with self._engine.begin() as connection:
            connection.execute(artefacts.delete().where(artefacts.c.entry == entry_id))
            if found:
                connection.execute(artefacts.insert(), [vars(artefact) for artefact in found])


def plain_files(folder: Path) -> Iterator[str]:
    """Names of the files under a folder that may be handed out: no link, nothing hidden, at most `MOST`."""
    count = 0
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if count < MOST and NAME.fullmatch(name) and is_plain(folder, name):
            count += 1
            yield name


def is_plain(folder: Path, name: str) -> bool:
    """Whether `name` is a file under `folder` that is reached without any link."""
    path = folder
    for part in name.split("/"):
        path = path / part
        if path.is_symlink():
            return False
    return path.is_file()


def described(entry_id: str, path: Path, name: str, known: StoredArtefact | None) -> StoredArtefact:
    """A file as it is; its digest is that of `known` where it has not changed since."""
    stat = path.stat()
    if known is not None and (known.bytes, known.modified_ns) == (stat.st_size, str(stat.st_mtime_ns)):
        return known
    media_type = _TYPES.get(path.suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return StoredArtefact(entry_id, name, media_type, stat.st_size, sha256, str(stat.st_mtime_ns))
