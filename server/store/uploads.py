"""What clients have sent or are sending, one file each."""

from __future__ import annotations

import re
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import sqlalchemy as sa

from server.errors import NotFoundError, StateError, UnknownReferenceError
from server.store.entries import now
from server.store.tables import uploads

State = Literal["open", "committed"]
_ID = re.compile(r"u\d{8}-\d{6}-[0-9a-f]{8}")


@dataclass(frozen=True)
class StoredUpload:
    """A file of `bytes` bytes; `name` is a label for people, and no path. An open one is still being sent."""

    id: str
    created: str
    name: str
    bytes: int
    sha256: str | None
    state: State = "open"


class Uploads:
    """The table of uploads."""

    def __init__(
        self,
        engine: sa.Engine,
        clock: Callable[[], datetime] = now,
        token: Callable[[], str] = lambda: secrets.token_hex(4),
    ) -> None:
        self._engine = engine
        self._clock = clock
        self._token = token

    def new(self, name: str, size: int, sha256: str | None) -> StoredUpload:
        """An upload that nobody knows of yet; ids sort by time."""
        moment = self._clock()
        upload_id = f"u{moment:%Y%m%d-%H%M%S}-{self._token()}"
        return StoredUpload(upload_id, moment.isoformat("T", "milliseconds"), name, size, sha256)

    def add(self, upload: StoredUpload) -> None:
        """Keep a new upload."""
        with self._engine.begin() as connection:
            connection.execute(uploads.insert(), vars(upload))

    def get(self, upload_id: str) -> StoredUpload:
        """One upload; raises NotFoundError."""
        found = self._select(uploads.c.id == upload_id) if _ID.fullmatch(upload_id) else []
        if not found:
            raise NotFoundError(f"found no upload {upload_id[:60]}", "one that GET /v1/uploads lists")
        return found[0]

    def committed(self, upload_id: str) -> StoredUpload:
        """One upload that is whole; raises UnknownReferenceError, and StateError before it is committed."""
        try:
            upload = self.get(upload_id)
        except NotFoundError as error:
            raise UnknownReferenceError(str(error)) from error
        if upload.state != "committed":
            raise StateError(f"found the upload {upload_id} {upload.state}", "it committed")
        return upload

    def page(self, before: str | None, limit: int) -> list[StoredUpload]:
        """The newest uploads older than the id `before`, at most `limit`."""
        return self._select(*([] if before is None else [uploads.c.id < before]), limit=limit)

    def commit(self, upload_id: str, sha256: str) -> None:
        """The upload is whole, and this is its digest."""
        with self._engine.begin() as connection:
            whole = {"state": "committed", "sha256": sha256}
            connection.execute(uploads.update().where(uploads.c.id == upload_id).values(whole))

    def remove(self, upload_id: str) -> None:
        """Forget an upload."""
        with self._engine.begin() as connection:
            connection.execute(uploads.delete().where(uploads.c.id == upload_id))

    def _select(self, *clauses: sa.ColumnElement[bool], limit: int | None = None) -> list[StoredUpload]:
        query = sa.select(uploads).where(*clauses).order_by(uploads.c.id.desc()).limit(limit)
        with self._engine.connect() as connection:
            return [StoredUpload(**row) for row in connection.execute(query).mappings()]
