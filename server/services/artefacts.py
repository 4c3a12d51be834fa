"""What jobs leave: listed and found by name, never by path."""

from __future__ import annotations

from pathlib import Path

from server.errors import NotFoundError
from server.schemas.jobs import Artefact
from server.store.artefacts import StoredArtefact, is_plain
from server.store.store import Store


class ArtefactService:
    """The artefacts of a service's jobs."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def list(self, job_id: str) -> list[Artefact]:
        """What the job has made so far; raises NotFoundError."""
        entry = self._store.entries.get("job", job_id)
        return [
            Artefact(name=one.name, media_type=one.media_type, bytes=one.bytes, sha256=one.sha256)
            for one in self._store.artefacts.of(entry.id)
        ]

    def find(self, job_id: str, name: str) -> tuple[Path, StoredArtefact]:
        """Path and description of an artefact that the catalogue names; raises NotFoundError."""
        entry = self._store.entries.get("job", job_id)
        folder = self._store.folder
        root = folder.run(job_id) if entry.type == "reconstruct" else folder.out(job_id)
        found = [one for one in self._store.artefacts.of(entry.id) if one.name == name]
        if not found or not is_plain(root, name):
            raise NotFoundError(
                f"found no artefact {name[:60]}, expected one that GET /v1/jobs/{job_id}/artefacts lists"
            )
        return root / name, found[0]
