"""Files that clients send, piece by piece: a connection that breaks loses the piece under way and no more."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from server.errors import DigestError, NotFoundError, OffsetError, StateError, UploadSizeError
from server.schemas.uploads import Upload, UploadRequest, Uploads
from server.services.queue import Key, Queue
from server.services.space import Space
from server.store.store import Store
from server.store.tables import StoredUpload
from server.store.upload_file import Appender, digest_of, held

_PIECE_BYTES = 1 << 20
_IDLE_S = 30.0  # a client that is silent for so long is gone, and another request may go on


class UploadService:
    """The uploads of a service, each at most `most_bytes` long; `keep_free` bytes of the disk are left free."""

    def __init__(self, store: Store, queue: Queue, space: Space, most_bytes: int, keep_free: int) -> None:
        self._store = store
        self._queue = queue
        self._space = space
        self._most_bytes = most_bytes
        self._keep_free = keep_free

    def create(self, request: UploadRequest, key: Key = None) -> Upload:
        """Begin an upload; raises UploadSizeError where it is too long, NoRoomError, IdempotencyError."""
        if request.bytes > self._most_bytes:
            raise UploadSizeError(f"found {request.bytes} bytes", f"at most {self._most_bytes} of an upload")
        uploads = self._store.uploads
        (upload_id,) = self._queue.ids("upload", [request], key, "uploads")
        if uploads.has(upload_id):
            return self.get(upload_id)
        upload = StoredUpload(upload_id, uploads.now(), request.name, request.bytes, request.sha256)
        path = self.path(upload.id)
        with self._space.promised(upload.bytes):
            if uploads.has(upload_id):  # the same request, sent twice at once, was faster
                return self.get(upload_id)
            path.parent.mkdir(exist_ok=True)  # it may be there of a request that failed
            path.touch()
            uploads.insert(upload)
        return self._shown(upload)

    def get(self, upload_id: str) -> Upload:
        """Return one upload and how much of it has come; raises NotFoundError."""
        return self._shown(self._store.uploads.get(upload_id))

    def list(self, before: str | None, limit: int) -> Uploads:
        """Return a page of uploads, newest first."""
        found = self._store.uploads.page(before, limit + 1)
        cursor = found[limit - 1].id if len(found) > limit else None
        return Uploads(items=[self._shown(upload) for upload in found[:limit]], next=cursor)

    async def receive(self, upload_id: str, offset: int, length: int | None, chunks: AsyncIterator[bytes]) -> Upload:
        """Append the bytes that come, `length` of them if that is known, a megabyte at a time.

        Raises NotFoundError, OffsetError, StateError where it is committed or another request writes to it,
        UploadSizeError for more bytes than were announced, UploadDiskError where they do not fit the disk.
        """
        upload = await run_in_threadpool(self._open, upload_id)
        path, pending = self.path(upload_id), bytearray()
        with held(path) as descriptor:
            appender = Appender(descriptor, path, offset, total=upload.bytes, keep_free=self._keep_free)
            appender.expect(length or 0)
            async for chunk in _until_gone(chunks):
                pending += chunk
                if len(pending) >= _PIECE_BYTES:
                    await run_in_threadpool(appender.write, bytes(pending))
                    pending.clear()
            await run_in_threadpool(appender.write, bytes(pending))
            await run_in_threadpool(appender.sync)
        return self._shown(upload)

    def commit(self, upload_id: str) -> Upload:
        """Check size and digest; an upload that is committed already stays so.

        Raises NotFoundError, OffsetError where bytes are missing, DigestError where they are not the announced ones.
        """
        upload = self._store.uploads.get(upload_id)
        if upload.state == "open":
            with held(self.path(upload_id)) as descriptor:
                size = self._store.folder.received(upload_id)
                if size != upload.bytes:
                    raise OffsetError(upload.bytes, size)
                sha256 = digest_of(descriptor)
                if upload.sha256 not in (None, sha256):
                    raise DigestError(
                        f"found the SHA-256 {sha256}", str(upload.sha256), "delete the upload and send it again"
                    )
                self._store.uploads.commit(upload_id, sha256)
        return self.get(upload_id)

    def delete(self, upload_id: str) -> None:
        """Forget an upload and its bytes; raises NotFoundError, StateError while it is written or imported."""
        upload = self._store.uploads.get(upload_id)
        self._queue.expect_unused(upload_id)
        try:
            with held(self.path(upload_id)):
                self._store.uploads.remove(upload.id)
        except NotFoundError:  # its bytes are gone, and nobody can write to it
            self._store.uploads.remove(upload.id)
        self._store.folder.remove(self.path(upload_id).parent)

    def path(self, upload_id: str) -> Path:
        """Return where the bytes of an upload lie."""
        return self._store.folder.upload(upload_id) / "data"

    def _open(self, upload_id: str) -> StoredUpload:
        upload = self._store.uploads.get(upload_id)
        if upload.state != "open":
            raise StateError(f"found {upload_id} committed", "it open", "begin another upload")
        return upload

    def _shown(self, upload: StoredUpload) -> Upload:
        return Upload(offset=self._store.folder.received(upload.id), **vars(upload))


async def _until_gone(chunks: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    """Yield what a client sends until it ends, breaks off or falls silent: the bytes that came are kept."""
    while True:
        try:
            async with asyncio.timeout(_IDLE_S):
                chunk = await anext(chunks)
        except (StopAsyncIteration, ClientDisconnect, TimeoutError):
            return
        yield chunk
