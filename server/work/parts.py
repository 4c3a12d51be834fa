"""Shares the training of a long recording among workers: hands its parts out, learns them, and wakes the job after."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

from sqlalchemy.exc import SQLAlchemyError

from reconstruction.run.parts import Failure, PartFolder
from server.part_queue import PartQueue, attempt_of, is_at_work, is_lost
from server.store.database import is_outage
from server.store.store import Store
from server.store.tables import Entry
from server.work.commands import reconstruct_arguments
from server.work.part_reporter import PARTS_SHARE, STAGE, PartReporter
from server.work.processes import Processes, attempt_of_run, is_finished, is_full
from server.work.reporter import Reporter
from server.work.supervisor import NoRoomStageError, StageError

TRIES = 3  # of a part that fails, before it is given up
_OUTAGE_POLL_S = 1.0
_LOG = logging.getLogger(__name__)
Found = TypeVar("Found")


class PartFailedError(StageError):
    """A part of a training has failed, and will again unless something is mended."""


class _Waits(NamedTuple):
    """The parts that can be handed out, and those that a job waits for."""

    due: list[str]
    at_work: set[str]

    @property
    def is_over(self) -> bool:
        return not self.due and not self.at_work


class Parts:
    """The parts of the jobs of one service, as the worker `worker` works on them."""

    def __init__(self, store: Store, queue: PartQueue, processes: Processes, worker: str) -> None:
        self._store = store
        self._queue = queue
        self._processes = processes
        self._worker = worker

    async def begin(self, entry_id: str) -> None:
        """Hand out the first parts of a job, and again those that failed or were stopped before."""
        await _patiently(partial(self._begin, entry_id))

    async def parked(self, entry_id: str) -> bool:
        """Return whether a job waits for its parts from now on; False where they are over, or it has none."""
        return await _patiently(partial(self._parked, entry_id))

    async def learn(self, entry_id: str, name: str) -> dict[str, Any] | None:
        """Learn a part; return None, or how it failed: `reason`, `bad_input`, and `room` where the disk is full."""
        entry = await _patiently(partial(self._entry, entry_id))
        folder, reporter = self._folder(entry), PartReporter(self._store, entry_id, name)
        run, recording = self._store.folder.run(entry_id), self._store.folder.recording(entry.capture or "")
        arguments = [*reconstruct_arguments(entry.request, STAGE, recording, run, entry.restart), "--part", name]
        try:
            await self._processes.run_part(entry, arguments, reporter, lambda: name not in folder.there())
        except (StageError, OSError) as error:
            if isinstance(error, OSError) and not is_full(error):
                raise
            full = isinstance(error, OSError | NoRoomStageError)
            return {"reason": reporter.said(str(error)), "bad_input": getattr(error, "bad_input", False), "room": full}
        return None

    async def end(self, entry_id: str, name: str, failed: dict[str, Any] | None, tries: int) -> None:
        """Give up a part that has failed, and hand out what has waited for it, or wake its job."""
        await _patiently(partial(self._end, entry_id, name, failed, tries))

    async def is_wanted(self, entry_id: str, attempt: int) -> bool:
        """Return whether a job goes on in the attempt of a part: it may have been cancelled, or begun again, since."""
        return await _patiently(partial(self._is_wanted, entry_id, attempt))

    async def expect_learnt(self, entry_id: str) -> None:
        """Raise PartFailedError where a part is missing that was not given up: its disk was full."""
        await _patiently(partial(self._expect_learnt, entry_id))

    def look(self) -> None:
        """Hand on what workers that died have left: to be called now and then."""
        found = self._queue.forgotten()
        for entry in self._store.entries.find(found) if found else ():
            try:
                self._go_on(entry)
            except OSError:  # of a shared folder that is away: it is looked at again
                _LOG.exception("the parts of %s cannot be looked at", entry.id)

    def _begin(self, entry_id: str) -> None:
        entry = self._entry(entry_id)
        folder, attempt = self._folder(entry), attempt_of(entry)
        if not folder.noted():
            return
        restart = entry.restart or {}
        if restart.get("stage") == STAGE and attempt_of_run(self._store.folder.run(entry_id)) < attempt:
            folder.forget()  # the first part does the rest of it
        there = folder.there()
        ended = [name for name, word in self._queue.states(entry).items() if is_lost(word) and name not in there]
        for name in ended:
            folder.try_again(name)
        self._queue.try_again(entry, ended)
        self._go_on(entry)

    def _parked(self, entry_id: str) -> bool:
        if self._waits_for(self._entry(entry_id)).is_over:
            return False
        self._queue.park(entry_id, self._worker)
        return True

    def _end(self, entry_id: str, name: str, failed: dict[str, Any] | None, tries: int) -> None:
        entry = self._entry(entry_id)
        if failed is not None and not failed["room"]:
            self._folder(entry).give_up(name, Failure(failed["reason"], tries, failed["bad_input"]))
        self._go_on(entry, name)

    def _go_on(self, entry: Entry, ending: str | None = None) -> None:
        """Hand out the parts that are due and, where there is none to wait for, wake the job; `ending` is about to."""
        if not self._queue.is_active(entry):
            return
        found = self._waits_for(entry, ending)
        self._queue.hand_out(entry, found.due)
        if found.is_over:
            self._queue.wake(entry.id)

    def _waits_for(self, entry: Entry, ending: str | None = None) -> _Waits:
        if is_finished(self._store.folder.run(entry.id), STAGE, entry):
            return _Waits([], set())
        folder, states = self._folder(entry), self._queue.states(entry)
        at_work = {name for name, word in states.items() if is_at_work(word)}
        over = folder.there() | folder.given_up()
        return _Waits([part.name for part in folder.due(states)], at_work - over - {ending})

    def _expect_learnt(self, entry_id: str) -> None:
        entry = self._entry(entry_id)
        folder, states = self._folder(entry), self._queue.states(entry)
        over = folder.there() | folder.given_up()
        for name in sorted(name for name, word in states.items() if is_lost(word) and name not in over):
            error = PartFailedError(f"part {name} of the training: {self._queue.reason(entry, name)}")
            Reporter(self._store, entry_id, STAGE, PARTS_SHARE).close(error)
            raise error

    def _is_wanted(self, entry_id: str, attempt: int) -> bool:
        entry = self._entry(entry_id)
        return attempt_of(entry) == attempt and self._queue.is_active(entry)

    def _folder(self, entry: Entry) -> PartFolder:
        return PartFolder(self._store.folder.run(entry.id))

    def _entry(self, entry_id: str) -> Entry:
        (entry,) = self._store.entries.find([entry_id])
        return entry


async def _patiently(look: Callable[[], Found]) -> Found:
    """Return what `look` does, in a thread; a database that does not answer is waited for."""
    while True:
        try:
            return await asyncio.to_thread(look)
        except SQLAlchemyError as error:
            if not is_outage(error):
                raise
        await asyncio.sleep(_OUTAGE_POLL_S)
