"""The files that jobs made: name, type, size and digest of each, kept by the worker that made it."""

import hashlib
import mimetypes
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from server.store.records import Records
from server.store.tables import StoredArtefact, artefacts

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*(/[A-Za-z0-9][A-Za-z0-9._-]*){0,3}")
MOST = 5000  # files of one job that can be listed
_BINARY = "application/octet-stream"
_TYPES = dict.fromkeys((".npy", ".npz", ".bin", ".ply", ".splat", ".spz"), _BINARY) | {
    ".glb": "model/gltf-binary",
    ".toml": "application/toml",
    ".txt": "text/plain",
}


class Artefacts(Records[StoredArtefact]):
    """The table of artefacts."""

    table, row = artefacts, StoredArtefact

    def of(self, entry_id: str) -> list[StoredArtefact]:
        """Return all artefacts of a job, by name."""
        return self.select(artefacts.c.entry == entry_id, order=artefacts.c.name)

    def catalogue(self, entry_id: str, folder: Path, names: Iterable[str]) -> int:
        """Note the first `MOST` of the files `names` under `folder`, and return how many there are.

        One that did not change is not read again.
        """
        known = {artefact.name: artefact for artefact in self.of(entry_id)}
        given = list(names)
        found = [described(entry_id, folder / name, name, known.get(name)) for name in given[:MOST]]
        with self._engine.begin() as connection:
            connection.execute(artefacts.delete().where(artefacts.c.entry == entry_id))
            if found:
                connection.execute(artefacts.insert(), [vars(artefact) for artefact in found])
        return len(given)


def plain_files(folder: Path) -> Iterator[str]:
    """Yield the names of files under a folder that may be handed out: no link, nothing hidden."""
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if NAME.fullmatch(name) and is_plain(folder, name):
            yield name


def is_plain(folder: Path, name: str) -> bool:
    """Return whether `name` is a file under `folder` that is reached without any link."""
    path = folder
    for part in name.split("/"):
        path = path / part
        if path.is_symlink():
            return False
    return path.is_file()


def described(entry_id: str, path: Path, name: str, known: StoredArtefact | None) -> StoredArtefact:
    """Return a file as it is now, with the digest of `known` where it has not changed since."""
    stat = path.stat()
    if known is not None and (known.bytes, known.modified_ns) == (stat.st_size, str(stat.st_mtime_ns)):
        return known
    media_type = _TYPES.get(path.suffix) or mimetypes.guess_type(name)[0] or _BINARY
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return StoredArtefact(entry_id, name, media_type, stat.st_size, sha256, str(stat.st_mtime_ns))
