"""Hands events on to everyone who listens: one reader of the table, however many listeners."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncGenerator, AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass

from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event
from sqlalchemy.exc import SQLAlchemyError

from server.schemas.progress import ACTIVE, Event
from server.store import tables
from server.store.store import Store

_POLL_S = 0.25
_KEEP_ALIVE_S = 15.0
_WAITING = 512  # events that a listener may be behind
_PAGE = 500
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Frame:
    """An event as it is sent; `status` is None for a progress report."""

    seq: int
    entry: str
    status: str | None
    content: bytes


class Listener:
    """The frames that one listener has yet to be sent; after `None` nothing more comes."""

    def __init__(self, entry_id: str | None) -> None:
        self.entry_id = entry_id
        self.waiting: asyncio.Queue[Frame | None] = asyncio.Queue(_WAITING + 1)

    def give(self, frame: Frame) -> bool:
        """Hand a frame on; return False where the listener is too far behind."""
        if self.waiting.qsize() >= _WAITING:
            return False
        self.waiting.put_nowait(frame)
        return True

    def end(self) -> None:
        """End the stream after the frames that are waiting."""
        if not self.waiting.full():
            self.waiting.put_nowait(None)


class Hub:
    """Reads the table four times a second while anyone listens. Belongs to the event loop that it was started in."""

    def __init__(self, store: Store, poll_s: float = _POLL_S, keep_alive_s: float = _KEEP_ALIVE_S) -> None:
        self._store = store
        self._poll_s = poll_s
        self._keep_alive_s = keep_alive_s
        self._listeners: set[Listener] = set()
        self._seq = 0
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
        for listener in self._listeners:
            listener.end()
        self._listeners.clear()

    def newest(self) -> int:
        """Return the number of the newest event."""
        return self._store.events.last()

    def is_over(self, after: int, entry_id: str) -> bool:
        """Return whether an entry has ended, and nothing happened to it after number `after`."""
        return self._told(entry_id) not in ACTIVE and not self._store.events.after(after, entry_id, 1)

    async def stream(self, after: int, entry_id: str | None = None) -> AsyncGenerator[bytes]:
        """Yield server-sent events after number `after`, of one entry or of all.

        The stream of an entry ends with the event that ends the entry; any stream ends where the service does, and
        where its reader is more than 512 events behind. Its reader then comes again with the last number it saw.
        """
        async with self._listening(entry_id) as listener:
            status = await asyncio.to_thread(self._told, entry_id)
            while frames := await asyncio.to_thread(self._read, after, entry_id):
                after = frames[-1].seq
                status = next((frame.status for frame in reversed(frames) if frame.status), status)
                yield b"".join(frame.content for frame in frames)
                if self._closed:
                    return
                if len(frames) < _PAGE:  # later ones are given to the listener
                    break
            if entry_id is not None and status not in ACTIVE:
                return
            async for frame in self._live(listener, after):
                yield frame.content if frame is not None else KEEPALIVE_COMMENT
                if frame is not None and entry_id is not None and frame.status not in (None, *ACTIVE):
                    return

    async def _live(self, listener: Listener, after: int) -> AsyncIterator[Frame | None]:
        """Yield frames as they come, None after a silence."""
        while True:
            try:
                frame = await asyncio.wait_for(listener.waiting.get(), self._keep_alive_s)
            except TimeoutError:
                yield None
                continue
            if frame is None:
                return
            if frame.seq > after:
                yield frame

    @asynccontextmanager
    async def _listening(self, entry_id: str | None) -> AsyncIterator[Listener]:
        if not self._listeners:  # nobody was there to read the events of the meantime, nor is any of them due here
            newest = await asyncio.to_thread(self.newest)
            if not self._listeners:
                self._seq = max(self._seq, newest)
        listener = Listener(entry_id)
        self._listeners.add(listener)
        if self._closed:
            listener.end()
        try:
            yield listener
        finally:
            self._listeners.discard(listener)

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(self._poll_s)
            await self._look()

    async def _look(self) -> None:
        if not self._listeners:
            return
        try:
            frames = await asyncio.to_thread(self._read, self._seq)
        except SQLAlchemyError:
            _LOG.exception("the event streams go on after an error")
            return
        for frame in frames:
            self._seq = frame.seq
            for listener in list(self._listeners):
                if listener.entry_id in (None, frame.entry) and not listener.give(frame):
                    listener.end()
                    self._listeners.discard(listener)

    def _told(self, entry_id: str | None) -> str:
        found = self._store.entries.find([entry_id]) if entry_id is not None else []
        told = found[0].told if found else "done"
        return "queued" if told == "new" else told

    def _read(self, after: int, entry_id: str | None = None) -> Sequence[Frame]:
        return [_framed(event) for event in self._store.events.after(after, entry_id, _PAGE)]


def _framed(event: tables.Event) -> Frame:
    content = format_sse_event(
        data_str=Event.model_validate(vars(event)).model_dump_json(), event=event.kind, id=str(event.seq)
    )
    status = str(event.data["status"]) if event.kind == "status" else None
    return Frame(event.seq, event.entry, status, content)
