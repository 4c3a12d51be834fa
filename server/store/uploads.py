"""The files that clients have sent or are sending."""

import re

from server.errors import NotFoundError, StateError, referred
from server.store.records import Records
from server.store.tables import StoredUpload, uploads

_ID = re.compile(r"u\d{8}-\d{6}-[0-9a-f]{8}")


class Uploads(Records[StoredUpload]):
    """The table of uploads."""

    table, row = uploads, StoredUpload

    def has(self, upload_id: str) -> bool:
        """Return whether there is such an upload."""
        return bool(self.select(uploads.c.id == upload_id))

    def get(self, upload_id: str) -> StoredUpload:
        """Return one upload; raises NotFoundError."""
        found = self.select(uploads.c.id == upload_id) if _ID.fullmatch(upload_id) else []
        if not found:
            raise NotFoundError(f"found no upload {upload_id[:60]}", "one that GET /v1/uploads lists")
        return found[0]

    def committed(self, upload_id: str) -> StoredUpload:
        """Return one upload that is whole; raises UnknownReferenceError, and StateError before it is committed."""
        with referred():
            upload = self.get(upload_id)
        if upload.state != "committed":
            raise StateError(f"found the upload {upload_id} {upload.state}", "it committed")
        return upload

    def page(self, before: str | None, limit: int) -> list[StoredUpload]:
        """Return the newest uploads older than the id `before`, at most `limit`."""
        older = () if before is None else (uploads.c.id < before,)
        return self.select(*older, order=uploads.c.id.desc(), limit=limit)

    def open(self) -> list[StoredUpload]:
        """Return those that are still being sent."""
        return self.select(uploads.c.state == "open")

    def before(self, created: str) -> list[StoredUpload]:
        """Return those that were begun before a moment, as rows carry it."""
        return self.select(uploads.c.created < created)

    def commit(self, upload_id: str, sha256: str) -> None:
        """Note that the upload is whole, and its digest."""
        self.update(uploads.c.id == upload_id, state="committed", sha256=sha256)

    def remove(self, upload_id: str) -> None:
        """Forget an upload."""
        self.delete(uploads.c.id == upload_id)
