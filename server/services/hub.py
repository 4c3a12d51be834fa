"""Hands events on to everyone who listens: one reader of the table, however many listeners."""

import asyncio
import logging
from collections import deque
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from sqlalchemy.exc import SQLAlchemyError

from server.schemas.progress import ACTIVE, Event
from server.store.store import Store

_POLL_S = 0.25
_KEEP_ALIVE_S = 15.0
_KEPT = 512  # events that every listener may still be sent without a look at the table
_PAGE = 500
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Frame:
    """An event as it is sent; `status` is None for a progress report."""

    seq: int
    entry: str
    status: str | None
    content: bytes


class Hub:
    """Reads the table four times a second while anyone listens. Belongs to the event loop that it was started in."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._listeners = 0
        self._recent: deque[Frame] = deque(maxlen=_KEPT)  # all events after number `_from`, up to `_seq`
        self._from = self._seq = 0
        self._more = asyncio.Event()  # set when events come; a new one then takes its place
        self._closed = False
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin to read."""
        self._closed = False
        self._task = asyncio.get_running_loop().create_task(self._run())

    def close(self) -> None:
        """End every stream and stop reading; more than once does no harm."""
        self._closed = True
        if self._task is not None:
            self._task.cancel()
            self._task = None
        self._wake()

    def newest(self) -> int:
        """Return the number of the newest event."""
        return self._store.events.last()

    def is_over(self, after: int, entry_id: str) -> bool:
        """Return whether an entry has ended, and nothing happened to it after number `after`."""
        return self._told(entry_id) not in ACTIVE and not self._store.events.after(after, entry_id, 1)

    async def stream(self, after: int, entry_id: str | None = None) -> AsyncGenerator[bytes]:
        """Yield server-sent events after number `after`, of one entry or of all, and a comment now and then.

        The stream of an entry ends with the event that ends the entry; any stream ends where the service does.
        """
        async with self._listening():
            status = await asyncio.to_thread(self._told, entry_id)
            while not self._closed:
                more = self._more
                frames, after = await self._next(after, entry_id)
                if frames:
                    status = next((frame.status for frame in reversed(frames) if frame.status), status)
                    yield b"".join(frame.content for frame in frames)
                elif entry_id is not None and status not in ACTIVE:
                    return
                else:
                    try:
                        await asyncio.wait_for(more.wait(), _KEEP_ALIVE_S)
                    except TimeoutError:
                        yield KEEPALIVE_COMMENT

    async def _next(self, after: int, entry_id: str | None) -> tuple[list[Frame], int]:
        """Return the next frames after number `after`, and the number up to which there is no other."""
        seq = self._seq
        if after >= self._from:
            recent = [frame for frame in self._recent if frame.seq > after and entry_id in (None, frame.entry)]
            return recent, max(after, seq)
        frames = await asyncio.to_thread(self._read, after, entry_id)
        last = frames[-1].seq if frames else after
        return frames, last if len(frames) == _PAGE else max(last, seq)

    @asynccontextmanager
    async def _listening(self) -> AsyncIterator[None]:
        if not self._listeners:  # nobody has read the table since the last listener went
            newest = await asyncio.to_thread(self.newest)
            if not self._listeners:
                self._recent.clear()
                self._from = self._seq = max(self._seq, newest)
        self._listeners += 1
        try:
            yield
        finally:
            self._listeners -= 1

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(_POLL_S)
            try:
                frames = await asyncio.to_thread(self._read, self._seq) if self._listeners else []
            except SQLAlchemyError:
                _LOG.exception("the event streams go on after an error")
                continue
            for frame in frames:
                if frame.seq > self._seq:  # else the first of new listeners came while the table was read
                    if len(self._recent) == _KEPT:
                        self._from = self._recent[0].seq
                    self._recent.append(frame)
                    self._seq = frame.seq
            if frames:
                self._wake()

    def _wake(self) -> None:
        self._more.set()
        self._more = asyncio.Event()

    def _told(self, entry_id: str | None) -> str:
        found = self._store.entries.find([entry_id]) if entry_id is not None else []
        told = found[0].told if found else "done"
        return "queued" if told == "new" else told

    def _read(self, after: int, entry_id: str | None = None) -> list[Frame]:
        frames = []
        for event in self._store.events.after(after, entry_id, _PAGE):
            data = Event.model_validate(vars(event)).model_dump_json()
            status = str(event.data["status"]) if event.kind == "status" else None
            content = format_sse_event(data_str=data, event=event.kind, id=str(event.seq))
            frames.append(Frame(event.seq, event.entry, status, content))
        return frames
