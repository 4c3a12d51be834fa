"""The last look of each rig: all cameras together, one by one, and in figures."""

import time
from collections.abc import Callable
from typing import TypeVar

from server.errors import NotFoundError
from server.schemas.pictures import LookFigures
from server.schemas.rigs import Look
from server.services.captures import RigService
from server.services.previews import Picture
from server.store.looks import KeptLook
from server.store.store import Store

_F = TypeVar("_F")


class LookService:
    """The last look of each rig. Its methods raise NotFoundError for an unknown rig or one never looked at."""

    def __init__(self, store: Store, rigs: RigService) -> None:
        self._store = store
        self._rigs = rigs

    def sheet(self, rig_id: str) -> Picture:
        """Return one picture of all cameras."""
        self._rigs.rig(rig_id)
        path = self._store.folder.rig(rig_id) / "look.png"
        return Picture.of(self._found(rig_id, path.read_bytes))

    def camera(self, rig_id: str, camera_id: str) -> Picture:
        """Return the picture of one camera in its own size."""
        return Picture.of(self._kept(rig_id).picture(camera_id))

    def figures(self, rig_id: str) -> LookFigures:
        """Return how sharp and how bright each camera's picture is."""
        kept = self._kept(rig_id)
        return LookFigures(rig=rig_id, age_s=kept.age_s, etag=Picture.of(kept.digested).etag, cameras=kept.figures)

    def newest(self, rig_id: str) -> Look | None:
        """Return the age of the last look and the tag of its picture, None before the first."""
        path = self._store.folder.rig(rig_id) / "look.png"
        if not path.exists():
            return None
        return Look(age_s=max(0.0, time.time() - path.stat().st_mtime), etag=self.sheet(rig_id).etag)

    def _kept(self, rig_id: str) -> KeptLook:
        self._rigs.rig(rig_id)
        folder = self._store.folder.rig(rig_id)
        return self._found(rig_id, lambda: KeptLook(folder))

    def _found(self, rig_id: str, read: Callable[[], _F]) -> _F:
        try:
            return read()
        except FileNotFoundError as error:
            raise NotFoundError(
                f"found no picture of rig {rig_id}", "a look before", f"POST /v1/rigs/{rig_id}/look makes one"
            ) from error
