"""The files that jobs leave: listed and found by name, never by path."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from zipstream import ZipStream

from server.engine import Engine
from server.errors import NotFoundError, StateError
from server.etags import tag
from server.schemas.jobs import Artefact
from server.schemas.progress import ACTIVE
from server.store.artefacts import described, is_plain
from server.store.store import Store
from server.store.tables import Entry, StoredArtefact


class Archive(NamedTuple):
    """A zip of `size` bytes in `parts`; `etag` names its content."""

    size: int
    etag: str
    parts: Iterator[bytes]


class ArtefactService:
    """The artefacts of a service's jobs. Its methods raise NotFoundError for an unknown job."""

    def __init__(self, store: Store, engine: Engine) -> None:
        self._store = store
        self._engine = engine

    def list(self, job_id: str) -> list[Artefact]:
        """Return what the job has made so far."""
        return [Artefact.model_validate(vars(one)) for one in self._of(job_id)[1]]

    def find(self, job_id: str, name: str) -> tuple[Path, StoredArtefact]:
        """Return path and description, as it is now, of an artefact of the catalogue; raises NotFoundError."""
        entry, known = self._of(job_id)
        path = self._root(entry) / name
        for one in known:
            if one.name == name and is_plain(self._root(entry), name):
                return path, described(entry.id, path, name, one)  # a job at work may have written it again
        raise NotFoundError(f"found no artefact {name[:60]}", f"one that GET /v1/jobs/{job_id}/artefacts lists")

    def archive(self, job_id: str) -> Archive:
        """Return a zip of all artefacts, whose bytes are made while they are read.

        Raises StateError while the job may still change them.
        """
        entry, known = self._of(job_id)
        status = self._engine.status(entry)
        if status in ACTIVE:
            raise StateError(f"found {job_id} {status}", "it ended", "its artefacts may be had one by one")
        root = self._root(entry)
        archive = ZipStream(sized=True)  # stored as they are: pictures, films and digits of noise do not shrink
        for one in known:
            if is_plain(root, one.name):
                archive.add_path(root / one.name, f"{job_id}/{one.name}")
        digest = hashlib.sha256("".join(f"{one.name} {one.sha256} " for one in known).encode()).hexdigest()
        return Archive(len(archive), tag(digest), iter(archive))

    def thumbnail(self, job_id: str) -> str:
        """Return the name of a small picture of the reconstructed scene; raises NotFoundError."""
        for one in self._of(job_id)[1]:
            if one.name.startswith("thumbnails/") and one.media_type.startswith("image/"):
                return one.name
        raise NotFoundError(f"found no thumbnail of {job_id}", "a reconstruction that has its report")

    def _of(self, job_id: str) -> tuple[Entry, list[StoredArtefact]]:
        entry = self._store.entries.get("job", job_id)
        return entry, self._store.artefacts.of(entry.id)

    def _root(self, entry: Entry) -> Path:
        folder = self._store.folder
        return folder.run(entry.id) if entry.type == "reconstruct" else folder.out(entry.id)
