"""What jobs leave: listed and found by name, never by path."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from zipstream import ZipStream

from server.engine import Engine
from server.errors import NotFoundError, StateError
from server.schemas.artefacts import Artefact
from server.schemas.progress import ACTIVE
from server.store.artefacts import StoredArtefact, described, is_plain
from server.store.entries import Entry
from server.store.store import Store


class ArtefactService:
    """The artefacts of a service's jobs."""

    def __init__(self, store: Store, engine: Engine) -> None:
        self._store = store
        self._engine = engine

    def list(self, job_id: str) -> list[Artefact]:
        """What the job has made so far; raises NotFoundError."""
        entry = self._store.entries.get("job", job_id)
        return [
            Artefact(name=one.name, media_type=one.media_type, bytes=one.bytes, sha256=one.sha256)
            for one in self._store.artefacts.of(entry.id)
        ]

    def find(self, job_id: str, name: str) -> tuple[Path, StoredArtefact]:
        """Path and description, as it is now, of an artefact that the catalogue names; raises NotFoundError."""
        entry = self._store.entries.get("job", job_id)
        root = self._root(entry)
        found = [one for one in self._store.artefacts.of(entry.id) if one.name == name]
        if not found or not is_plain(root, name):
            raise NotFoundError(f"found no artefact {name[:60]}", f"one that GET /v1/jobs/{job_id}/artefacts lists")
        return root / name, described(entry.id, root / name, name, found[0])  # a job at work may have written it again

    def archive(self, job_id: str) -> tuple[int, Iterator[bytes]]:
        """The bytes of a zip of all artefacts, made while they are read, and how many they are.

        Raises NotFoundError, and StateError while the job may still change them.
        """
        entry = self._store.entries.get("job", job_id)
        status = self._engine.statuses([entry])[entry.id]
        if status in ACTIVE:
            raise StateError(f"found {job_id} {status}", "it ended", "its artefacts may be had one by one")
        root = self._root(entry)
        archive = ZipStream(sized=True)  # stored as they are: pictures, films and digits of noise do not shrink
        for one in self._store.artefacts.of(entry.id):
            if is_plain(root, one.name):
                archive.add_path(root / one.name, f"{job_id}/{one.name}")
        return len(archive), iter(archive)

    def thumbnail(self, job_id: str) -> str:
        """The name of a small picture of what was reconstructed; raises NotFoundError."""
        entry = self._store.entries.get("job", job_id)
        for one in self._store.artefacts.of(entry.id):
            if one.name.startswith("thumbnails/") and one.media_type.startswith("image/"):
                return one.name
        raise NotFoundError(f"found no thumbnail of {job_id}", "a reconstruction that has its report")

    def _root(self, entry: Entry) -> Path:
        folder = self._store.folder
        return folder.run(entry.id) if entry.type == "reconstruct" else folder.out(entry.id)
