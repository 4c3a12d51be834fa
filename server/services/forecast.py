"""Tells each job at work or to be done its place in the queue, and when it is expected to begin and to end."""

import functools
import math
from collections.abc import Collection, Iterable, Mapping
from datetime import UTC, datetime
from heapq import heappop, heappush
from typing import NamedTuple

from acquisition.errors import BadRecordingError
from acquisition.recording.reader import read_manifest
from server.engine import RECONSTRUCTIONS, Engine
from server.services.durations import Durations
from server.store.engine_tables import SPANS, WAITING, Place
from server.store.store import Store

_KNOWN = 1024  # captures whose planes stay known
_LOOK_AHEAD = 1000  # entries of a queue whose times are estimated; the others have a place alone


class Outlook(NamedTuple):
    """The place of a queued job, from 1 on, and times in ISO 8601; None where nothing tells."""

    position: int | None = None
    expected_begin: str | None = None
    expected_end: str | None = None


class Forecast:
    """Looks ahead along the queues: each worker takes one entry of each of its queues at a time.

    What is left of a job that waits for its parts is shared by all workers, after jobs that began before it.
    """

    def __init__(self, store: Store, engine: Engine) -> None:
        self._store = store
        self._engine = engine
        self._planes = functools.lru_cache(_KNOWN)(self._planes_kept)

    def of(self, active: Collection[str]) -> dict[str, Outlook]:
        """Return the outlooks of entries that are queued or running; one that waits for its capture has none."""
        if not active:
            return {}
        places = self._engine.places()
        wanted = set(active)
        queues = {place.queue for place in places if place.id in wanted}
        workers = [worker.queues for worker in self._store.workers.alive()]
        durations = Durations(self._store.entries, self._planes_of)
        trainers = sum(RECONSTRUCTIONS in theirs for theirs in workers)
        shared = self._shared([place.id for place in places if place.queue == WAITING], durations)
        found = _together(shared, self._store.clock(), trainers)
        for queue in queues - {WAITING}:
            mine = [place for place in places if place.queue == queue]
            parts = self._parts(sum(shared.values())) if queue == RECONSTRUCTIONS else []
            found |= self._of_queue(mine, sum(queue in theirs for theirs in workers), parts, durations)
        return {entry_id: outlook for entry_id, outlook in found.items() if entry_id in wanted}

    def _planes_of(self, capture_id: str) -> int | None:
        """Return the planes of a capture; None where it has none yet, or no longer."""
        try:
            return self._planes(capture_id)
        except BadRecordingError:
            return None

    def _planes_kept(self, capture_id: str) -> int:
        manifest = read_manifest(self._store.folder.recording(capture_id))
        return min(camera.planes for camera in manifest.cameras)

    def _shared(self, waiting: list[str], durations: Durations) -> dict[str, float]:
        """Return the seconds that one worker alone would take for what is left of jobs that wait for their parts."""
        now, reported = self._store.clock(), self._store.events.last_reports(waiting)
        entries = {entry.id: entry for entry in self._store.entries.found(waiting)} if waiting else {}
        left = {i: durations.left(entries[i], now - reported.get(i, now)) for i in waiting if i in entries}
        return {i: math.inf if seconds is None else seconds for i, seconds in left.items()}

    def _parts(self, left_s: float) -> list[float]:
        """Return the seconds until each worker that learns a part is free, where so many are left of all parts."""
        found = self._engine.count()
        running, queued = (found.get((SPANS, word), 0) for word in ("running", "queued"))
        return [left_s / (running + queued)] * running if running else []

    def _of_queue(
        self, places: list[Place], workers: int, parts: list[float], durations: Durations
    ) -> dict[str, Outlook]:
        running = [place.id for place in places if place.runs]
        waiting = [place.id for place in places if not place.runs]
        now = self._store.clock()
        entries = {entry.id: entry for entry in self._store.entries.found([*running, *waiting[:_LOOK_AHEAD]])}
        reported = self._store.events.last_reports(running)
        left = {i: durations.left(entries[i], now - reported.get(i, now)) for i in running if i in entries}
        found = {i: Outlook(None, None, _moment(now, seconds if workers else None)) for i, seconds in left.items()}
        free = _free_after([*left.values(), *parts], workers)
        for number, entry_id in enumerate(waiting):
            begin = end = None
            if free and entry_id in entries:
                begin, takes = heappop(free), durations.whole(entries[entry_id])
                end = begin + (math.inf if takes is None else takes)
                heappush(free, end)
            found[entry_id] = Outlook(number + 1, _moment(now, begin), _moment(now, end))
        return found


def _together(shared: Mapping[str, float], now: float, workers: int) -> dict[str, Outlook]:
    """Return when jobs end whose seconds of one worker are shared by so many, one job after the other."""
    found, until_s = {}, 0.0
    for entry_id, seconds in shared.items():
        until_s += seconds / workers if workers else math.inf
        found[entry_id] = Outlook(None, None, _moment(now, until_s))
    return found


def _free_after(left: Iterable[float | None], workers: int) -> list[float]:
    """Return a heap of the seconds after which each worker is free; infinite where nothing tells."""
    known = sorted(math.inf if seconds is None else seconds for seconds in left)
    known = known[max(0, len(known) - workers) :]  # of entries on dead workers the first to end frees nobody
    return sorted(known + [0.0] * (workers - len(known)))


def _moment(now: float, seconds: float | None) -> str | None:
    if seconds is None or math.isinf(seconds):
        return None
    return datetime.fromtimestamp(now + seconds, UTC).isoformat("T", "seconds")
